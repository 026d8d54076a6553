#!/bin/sh
# Simulator and filter in two network namespaces, with a bad link between them made by the kernel.
#
#   tools/network_namespaces.sh [FOLDER] [NETEM...]
#
# FOLDER is the environment (default: .venv), NETEM what `tc ... netem` is told; the default loses
# 1 %, delays by 20 ms with a jitter of 10 ms, and doubles 1 %. Prints what was sent, what the filter
# received and how many odometry messages it made of that. Ends with 77 where the kernel does not
# allow namespaces or has no netem.
set -eu
cd "$(dirname "$0")/.."
folder=${1:-.venv}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- loss 1% delay 20ms 10ms duplicate 1%

skip() {
    echo "skipped: $*" >&2
    exit 77
}

if [ -z "${INSDVL_NAMESPACE-}" ]; then
    for program in ip tc unshare nsenter; do
        command -v "$program" >/dev/null || skip "there is no $program on this machine"
    done
    [ -x "$folder/lib/ros_insdvl/filter" ] || { echo "$folder has no filter: make test builds it" >&2; exit 2; }
    unshare --user --net --map-root-user true 2>/dev/null ||
        skip "this machine does not allow network namespaces"
    # Both namespaces live in a user namespace of their own, and end with this script.
    INSDVL_NAMESPACE=1 exec unshare --user --net --map-root-user --kill-child --fork --pid --mount-proc \
        tools/network_namespaces.sh "$folder" "$@"
fi

folder=$(cd "$folder" && pwd)
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
export AMENT_PREFIX_PATH="$folder" ROS_LOG_DIR="$logs" ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET
# Shared memory would go around the link.
export FASTDDS_BUILTIN_TRANSPORTS=UDPv4

unshare --net sleep 600 &
other=$!
while [ "$(readlink "/proc/$other/ns/net")" = "$(readlink /proc/self/ns/net)" ]; do sleep 0.05; done
ip link add here type veth peer name there netns "$other" 2>/dev/null ||
    skip "this kernel makes no veth links in a user namespace"
ip address add 10.77.0.1/24 dev here
ip link set here up
ip link set lo up
inside() { nsenter --target "$other" --net "$@"; }
inside ip address add 10.77.0.2/24 dev there
inside ip link set there up
inside ip link set lo up
tc qdisc add dev here root netem "$@" 2>/dev/null || skip "this kernel has no netem ($*)"

# Not by the function: the process to be ended would be a shell.
nsenter --target "$other" --net "$folder/lib/ros_insdvl/filter" --ros-args -p initial.mode:=topic \
    >"$logs/filter" 2>&1 &
filter=$!
"$folder/lib/ros_insdvl_sim/simulator" --ros-args -p duration:=30.0 -p rate_factor:=1.0 \
    -p min_subscribers:=1 -p noise.profile:=constant >"$logs/simulator" 2>&1 ||
    { cat "$logs/simulator" >&2; exit 1; }
grep '^sent' "$logs/simulator"
inside "$folder/bin/python" - <<'END'
from ros_insdvl_sim.trials.names import FILTER_NODE
from ros_insdvl_sim.trials.witness import Witness

witness = Witness()
count = witness.diagnostics.count
witness.until_reported(FILTER_NODE)
witness.until_settled(lambda: count(FILTER_NODE, "sent odometry/filtered"), FILTER_NODE)
received = "received imu/data_raw", "received dvl/velocity"
keys = *received, "sent odometry/filtered", "samples missing"
print("filter: " + ", ".join(f"{key} {count(FILTER_NODE, key)}" for key in keys))
witness.close()
END
kill "$filter"
wait "$filter" || { cat "$logs/filter" >&2; exit 1; }
echo "the filter's log:"
cat "$logs/filter"
kill "$other"
