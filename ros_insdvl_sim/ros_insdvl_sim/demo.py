"""The demo: a simulated AUV, navigated by two filters at once in a real graph.

Simulator, tuner and two filters run as separate processes. `/constant/insdvl_filter` keeps its
nominal process noise, `/learned/insdvl_filter` takes it from the tuner. This process listens, shows
a live table, and at the end counts the messages, scores both filters against the truth and draws
them.
"""

import argparse
import json
import math
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from insdvl import files
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, rpy_from_rotation
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw
from insdvl.simulation.trajectories import trajectory_named
from insdvl.studies.evaluation import plots
from insdvl.studies.evaluation.metrics import Scores, Track, scores
from ros_insdvl.monitor import Monitor, OdometrySeries
from ros_insdvl.node import publisher_qos, subscribe
from ros_insdvl_sim.harness import (
    DEPTH,
    DVL,
    FILTER,
    IMU,
    SIMULATOR,
    TUNER,
    HarnessError,
    Processes,
    graph_environment,
    guarded,
    lossless,
    sent_by,
)

Array = NDArray[np.float64]

SCENARIOS = ("constant", "constant-tableI", "varying", "wide")
TRAJECTORY = "auv"
IMU_RATE = 100.0  # Hz
FILTERS = ("/constant", "/learned")
CONSUMERS = ("tuner", "constant", "learned")  # processes

#: Speed against real time that leaves two cores some room (the graph then uses about 75 % of them;
#: at 11 it loses messages), on a machine that serialises and deserialises an odometry message in
#: this time.
FULL_SPEED = 7.0
REFERENCE_MESSAGE_TIME = 90e-6  # s

RECORDING_SPEED = 0.6  # of the speed without a recorder, which takes as much as all else

OUTPUT_DELAY = 2.0  # s, of the filters' odometry

START_TIME = 300.0  # s for all nodes to be there; without a cache they first compile
QUIET_TIME = 6.0  # s without any new message after which the rest is lost

RECORDED = {
    "/imu/data_raw": "sensor_msgs/msg/Imu",
    "/dvl/velocity": "geometry_msgs/msg/TwistStamped",
    "/process_noise": "sensor_msgs/msg/Imu",
    "/ground_truth/odometry": "nav_msgs/msg/Odometry",
    "/ground_truth/process_noise": "sensor_msgs/msg/Imu",
    **{
        f"{namespace}/{topic}": kind
        for namespace in FILTERS
        for topic, kind in (
            ("odometry/filtered", "nav_msgs/msg/Odometry"),
            ("imu/bias", "sensor_msgs/msg/Imu"),
            ("dvl/innovation", "geometry_msgs/msg/TwistWithCovarianceStamped"),
        )
    },
}


@dataclass(frozen=True)
class Count:
    """Messages of a topic that a node sent, and those that one consumer received."""

    consumer: str
    topic: str
    sent: int
    received: int


def choose_rate_factor() -> float:
    """The speed that this machine can hold, from its cores and the time that a message takes."""
    message, repeats = Odometry(), 100
    message_time = math.inf
    for _ in range(20):  # the fastest of many short runs is the machine's, not its load's
        begin = time.perf_counter()
        for _ in range(repeats):
            deserialize_message(serialize_message(message), Odometry)
        message_time = min(message_time, (time.perf_counter() - begin) / repeats)
    cores = len(os.sched_getaffinity(0))
    factor = FULL_SPEED * min(1.0, cores / 2) * min(1.0, REFERENCE_MESSAGE_TIME / message_time)
    return max(round(factor, 1), 0.5)


def initial_parameters(seed: int) -> dict[str, Any]:
    """Parameters of the initial state: the truth at the first IMU stamp with an error from P_0."""
    trajectory = trajectory_named(TRAJECTORY)
    truth = trajectory.truth(np.array([1.0 / IMU_RATE]))
    sigma = FilterParameters().initial
    rng = np.random.default_rng([seed, 1])
    psi = rng.normal(0.0, [sigma.tilt_std, sigma.tilt_std, sigma.heading_std])
    C_n_b = Rotation.from_rotvec(psi).as_matrix().T @ truth.C_n_b[0]  # C_true = exp([psi x]) C
    v_b = truth.C_n_b[0].T @ truth.v_n[0] + rng.normal(0.0, sigma.velocity_std, 3)
    p_n = truth.p_n[0] + rng.normal(0.0, sigma.position_std, 3)
    return {
        "initial": {
            "mode": "parameters",
            "position": (ENU.nav @ p_n).tolist(),
            "rpy": rpy_from_rotation(ENU.attitude(C_n_b)).tolist(),
            "velocity": (ENU.body @ v_b).tolist(),
            "velocity_frame": "body",
        },
        "origin": {
            "latitude_deg": float(np.degrees(trajectory.lat_0)),
            "longitude_deg": float(np.degrees(trajectory.lon_0)),
            "height": float(trajectory.h_0),
        },
    }


def start_consumers(processes: Processes, out: Path, initial: Mapping[str, Any]) -> None:
    """Start the tuner and both filters; their parameters are saved for `insdvl replay`."""
    processes.start("tuner", TUNER, lossless(f"/{IMU}"))
    shared = ("imu/data_raw", "dvl/velocity", "dvl/velocity_cov", "process_noise")
    remaps = {topic: f"/{topic}" for topic in shared}
    for namespace, source in zip(FILTERS, ("constant", "external"), strict=True):
        name = namespace.strip("/")
        parameters = out / f"{name}.yaml"
        # As in the evaluation: with the gate, a wrong Q would mostly cost rejected measurements.
        section = {
            **initial,
            "gate": {"enabled": False},
            # What is published waits for the DVL and for Q, so the seed alone decides the result;
            # a tuner that is held up does not make its Q too late.
            "output_delay": OUTPUT_DELAY,
            "max_delay": 10.0,
            "process_noise": {"source": source},
        }
        document = {"/**/insdvl_filter": {"ros__parameters": section}}
        files.write(parameters, yaml.safe_dump(document, sort_keys=False).encode())
        processes.start(
            name,
            FILTER,
            lossless(f"/{IMU}", f"/{DVL}"),
            {"__ns": namespace, **remaps},
            parameter_file=parameters,
        )


def start_simulator(processes: Processes, options: argparse.Namespace, rate_factor: float) -> None:
    """Start the simulator; it plays when the consumers of imu/data_raw are there."""
    consumers = len(FILTERS) + 1 + (options.record is not None)
    values = {
        "trajectory": TRAJECTORY,
        "duration": options.duration,
        "seed": options.seed,
        "rate_factor": rate_factor,
        "noise.profile": options.scenario,
        "min_subscribers": consumers,
    }
    processes.start("simulator", SIMULATOR, values)


class Listener:
    """The demo's own node: the monitor, which keeps everything, and a recorder if wanted."""

    def __init__(self, writer: BagWriter | None) -> None:
        topics = ["ground_truth/odometry", *(f"{name}/odometry/filtered" for name in FILTERS)]
        overrides = {
            "filters": list(FILTERS),
            "keep": 10_000_000,
            **lossless(*(topic if topic[0] == "/" else f"/{topic}" for topic in topics)),
        }
        self.monitor = Monitor(
            parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()]
        )
        self.recorded: Counter[str] = Counter()
        if writer is not None:
            for topic, kind in RECORDED.items():
                self.recorded[topic] = 0
                self._record(writer, topic, kind)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.monitor)

    def _record(self, writer: BagWriter, topic: str, kind: str) -> None:
        package, _, name = kind.split("/")
        message_type = getattr(__import__(f"{package}.msg", fromlist=[name]), name)
        qos = publisher_qos()
        qos.depth = DEPTH

        def write(data: bytes) -> None:
            writer.write(Raw(topic, kind, time.time_ns(), data))
            self.recorded[topic] += 1

        subscribe(self.monitor, message_type, topic, write, qos, raw=True)

    def spin(self, seconds: float) -> None:
        """Handle messages for a time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            # The executor takes turns between topics only while the time-out stays the same.
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Take the node down."""
        self._executor.remove_node(self.monitor)
        self.monitor.destroy_node()

    def ready(self) -> bool:
        """Whether all consumers are in the graph and publish their diagnostics."""
        nodes = {"/insdvl_tuner", *(f"{name}/insdvl_filter" for name in FILTERS)}
        return nodes <= self.monitor.values.keys()

    def counts(self, sent: Mapping[str, int]) -> list[Count]:
        """Messages sent and received.

        Args:
            sent: By the simulator, per topic.
        """
        values = self.monitor.values
        counts = []

        def add(consumer: str, topic: str, sent: int, received: int) -> None:
            counts.append(Count(consumer, topic, sent, received))

        def told(node: str, key: str) -> int:
            return int(values.get(node, {}).get(key, 0))

        q_sent = told("/insdvl_tuner", "sent process_noise")
        add("tuner", IMU, sent[IMU], told("/insdvl_tuner", f"received {IMU}"))
        for name in FILTERS:
            node = f"{name}/insdvl_filter"
            for topic in (IMU, DVL):
                add(f"{name} filter", topic, sent[topic], told(node, f"received {topic}"))
        add(
            "/learned filter",
            "process_noise",
            q_sent,
            told("/learned/insdvl_filter", "received process_noise"),
        )
        received = self.monitor.received
        for topic in ("ground_truth/odometry", "ground_truth/process_noise"):
            add("demo", topic, sent[topic], received[topic])
        add("demo", "process_noise", q_sent, received["process_noise"])
        for name in FILTERS:
            odometry = told(f"{name}/insdvl_filter", "sent odometry/filtered")
            add(
                "demo", f"{name}/odometry/filtered", odometry, received[f"{name}/odometry/filtered"]
            )
        for topic, recorded in self.recorded.items():
            owner = next((name for name in FILTERS if topic.startswith(name)), None)
            if owner is not None:
                of_node = topic.removeprefix(f"{owner}/")
                all_sent = told(f"{owner}/insdvl_filter", f"sent {of_node}")
            else:
                all_sent = q_sent if topic == "/process_noise" else sent[topic.lstrip("/")]
            add("recording", topic, all_sent, recorded)
        return counts


def wait_until_ready(processes: Processes, listener: Listener) -> None:
    """Wait for the consumers, then make sure that nobody else publishes for them.

    Raises:
        HarnessError: A process died, they do not come up, or there is another publisher.
    """
    deadline = time.monotonic() + START_TIME
    while not listener.ready():
        listener.spin(0.05)
        processes.check(*CONSUMERS)
        if time.monotonic() > deadline:
            raise HarnessError(f"not all nodes were there within {START_TIME:g} s")
    if listener.monitor.count_publishers("/imu/data_raw"):
        raise HarnessError(
            "/imu/data_raw already has a publisher: the demo would mix with it; stop it, or choose "
            "another ROS_DOMAIN_ID"
        )


def fly(processes: Processes, listener: Listener) -> dict[str, int]:
    """Let the mission run to its end; returns what the simulator sent, per topic.

    Raises:
        HarnessError: A process died.
    """
    while not processes.finished("simulator"):
        listener.spin(0.2)
        processes.check(*CONSUMERS)
    return sent_by(processes.text("simulator"))


def collect(processes: Processes, listener: Listener, sent: Mapping[str, int]) -> list[Count]:
    """Wait for the last messages, as long as there are new ones; returns the counts."""
    quiet_since, counts = time.monotonic(), listener.counts(sent)
    while any(c.sent != c.received for c in counts):
        listener.spin(0.1)
        processes.check(*CONSUMERS)
        newer = listener.counts(sent)
        if newer != counts:
            quiet_since, counts = time.monotonic(), newer
        elif time.monotonic() - quiet_since > QUIET_TIME:
            break
    return counts


def track_of(rows: Array) -> Track:
    """The states of an odometry series."""
    return Track(
        C_n_b=Rotation.from_quat(rows[:, OdometrySeries.QUATERNION]).as_matrix(),
        v_b=rows[:, OdometrySeries.VELOCITY],
        p_n=rows[:, OdometrySeries.POSITION],
    )


@dataclass(frozen=True)
class Outcome:
    """Truth and results at the stamps that both filters and the truth have.

    Attributes:
        t: (N,) time from the start of the mission [s].
        truth: (N,).
        results: Per filter.
        noises: True and learned process noise.
        scores: Per filter.
    """

    t: Array
    truth: Track
    results: list[plots.Result]
    noises: list[plots.Noise]
    scores: dict[str, Scores]


def evaluate(monitor: Monitor) -> Outcome:
    """Score both filters over all IMU stamps from when both are initialised.

    Raises:
        HarnessError: There is nothing to score.
    """
    true_stamps, true_rows = monitor.truth.arrays()
    series = {w.label.strip("/"): w.series.arrays() for w in monitor.filters}
    stamps = true_stamps
    for filter_stamps, _ in series.values():
        stamps = np.intersect1d(stamps, filter_stamps)
    if stamps.size < 2:
        raise HarnessError("no stamps in common between the truth and the filters")
    start_ns = int(true_stamps[0])
    truth = track_of(true_rows[np.searchsorted(true_stamps, stamps)])
    results, scored = [], {}
    for label, (filter_stamps, rows) in series.items():
        rows = rows[np.searchsorted(filter_stamps, stamps)]
        track = track_of(rows)
        sigma = np.sqrt(rows[:, OdometrySeries.VELOCITY_VARIANCE])
        results.append(plots.Result(label, track, sigma))
        scored[label] = scores(track, truth)
    noises = [
        plots.Noise(
            label,
            np.array([(stamp - start_ns) / NS for stamp, _ in kept]),
            np.array([variances for _, variances in kept]).reshape(-1, 6),
        )
        for label, kept in (("true", monitor.true_q), ("learned", monitor.learned_q))
    ]
    return Outcome((stamps - start_ns) / NS, truth, results, noises, scored)


def print_counts(counts: list[Count]) -> None:
    """Print what was sent and received."""
    print(f"\n{'messages':18}{'topic':30}{'sent':>8}{'received':>10}")
    for c in counts:
        lost = "" if c.sent == c.received else "   DIFFER"
        print(f"{c.consumer:18}{c.topic:30}{c.sent:>8}{c.received:>10}{lost}")


def print_scores(scored: Mapping[str, Scores]) -> None:
    """Print the scores, body velocity first, and which filter was better."""
    names = {
        "body_velocity_rmse": "body velocity RMSE [m/s]",
        "srmse": "SRMSE [m/s]",
        "smae": "SMAE [m/s]",
        "heading_rmse_deg": "heading RMSE [deg]",
        "tilt_rmse_deg": "tilt RMSE [deg]",
        "position_rmse_horizontal": "position RMSE, horizontal [m]",
        "position_drift_percent": "position drift [% of distance]",
    }
    print(f"\n{'error against the truth':34}" + "".join(f"{name:>12}" for name in scored))
    for key, text in names.items():
        print(f"{text:34}" + "".join(f"{getattr(s, key):12.4f}" for s in scored.values()))
    constant, learned = (scored[name.strip("/")].body_velocity_rmse for name in FILTERS)
    change = 100.0 * (learned / constant - 1.0)
    verdict = "better" if change < 0.0 else "WORSE"
    print(
        f"\nIn body velocity the learned process noise is {abs(change):.1f} % {verdict} than the "
        "constant one in this run."
    )


def print_second_terminal(variables: Mapping[str, str]) -> None:
    """Print how to look at the running graph."""
    exports = " ".join(f"{name}={value}" for name, value in variables.items())
    monitor = Path(get_package_prefix("ros_insdvl")) / "lib/ros_insdvl/monitor"
    print(
        "In a second terminal, with a full ROS 2 Jazzy:\n"
        f"  export {exports}\n"
        "  ros2 topic echo /learned/odometry/filtered --field pose.pose.position\n"
        "  ros2 topic echo /process_noise --field linear_acceleration_covariance\n"
        "  ros2 topic echo /diagnostics\n"
        "or, with what is installed here:\n"
        f"  {exports} AMENT_PREFIX_PATH={os.environ['AMENT_PREFIX_PATH']} {monitor} "
        "--ros-args -p 'filters:=[/constant, /learned]'\n",
        flush=True,
    )


@contextmanager
def recording(path: Path | None) -> Iterator[BagWriter | None]:
    """A new recording, or None."""
    if path is None:
        yield None
        return
    with BagWriter(path) as writer:
        yield writer


def run_demo(options: argparse.Namespace) -> int:
    """Run the demo; returns the exit code."""
    began = time.monotonic()
    out: Path = options.out
    logs = out / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    variables = graph_environment()
    os.environ.update(variables)
    share = 1.0 if options.record is None else RECORDING_SPEED
    rate_factor = options.rate_factor or round(share * choose_rate_factor(), 1)
    duration = options.duration or trajectory_named(TRAJECTORY).duration
    print(
        f"{duration:g} s of mission, scenario {options.scenario}, seed {options.seed}, "
        f"at {rate_factor:g} times real time; gate off, as in the evaluation"
    )
    print_second_terminal(variables)

    rclpy.init(args=[])
    with Processes(logs) as processes, recording(options.record) as writer:
        listener = Listener(writer)
        start_consumers(processes, out, initial_parameters(options.seed))
        wait_until_ready(processes, listener)
        start_simulator(processes, options, rate_factor)
        sent = fly(processes, listener)
        counts = collect(processes, listener, sent)
    codes = processes.stop()
    outcome = evaluate(listener.monitor)
    rejected = {w.label.strip("/"): w.rejected for w in listener.monitor.filters}
    listener.close()

    died = {name: code for name, code in codes.items() if code != 0}
    complete = all(c.sent == c.received for c in counts)
    title = (
        f"{duration:g} s AUV mission, scenario {options.scenario}, seed {options.seed}: "
        + ", ".join(f"{name} {s.body_velocity_rmse:.4f} m/s" for name, s in outcome.scores.items())
        + " (body velocity RMSE)"
    )
    picture = out / "mission.png"
    plots.mission(picture, title, outcome.t, outcome.truth, outcome.results, outcome.noises)
    print_counts(counts)
    print("rejected by the filters: " + ", ".join(f"{k} {n}" for k, n in rejected.items()))
    print_scores(outcome.scores)
    wall_time = time.monotonic() - began
    numbers = {
        "scenario": options.scenario,
        "seed": options.seed,
        "duration": duration,
        "rate_factor": rate_factor,
        "wall_time": round(wall_time, 2),
        "filters": {name: asdict(s) for name, s in outcome.scores.items()},
        "messages": [asdict(count) for count in counts],
        "rejected": rejected,
        "exit_codes": codes,
    }
    files.write(out / "summary.json", (json.dumps(numbers, indent=2) + "\n").encode())
    print(f"\n{picture}\n{out / 'summary.json'}\n{wall_time:.1f} s in all")
    if options.record is not None:
        print(f"{listener.recorded.total()} messages in {options.record}")
    for name, code in died.items():
        print(f"{name} ended with exit code {code}, see {processes.log(name)}", file=sys.stderr)
    if not complete:
        print("messages were lost", file=sys.stderr)
    return 0 if complete and not died else 1


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", choices=SCENARIOS, default="varying")
    parser.add_argument("--seed", type=int, default=1, help="of all that is random")
    parser.add_argument(
        "--duration", type=float, default=0.0, help="seconds of mission; 0 is all of it"
    )
    parser.add_argument(
        "--rate-factor", type=float, default=0.0, help="speed; 0 chooses what the machine can hold"
    )
    parser.add_argument("--out", type=Path, default=Path("demo-output"), help="folder of results")
    parser.add_argument("--record", type=Path, metavar="BAG", help="record all topics as a rosbag2")
    options = parser.parse_args(arguments)
    shortest, longest = 2 * OUTPUT_DELAY, trajectory_named(TRAJECTORY).duration
    if options.duration and not shortest <= options.duration <= longest:
        parser.error(
            f"--duration must be 0 or from {shortest:g} to {longest:g} s, got {options.duration:g}"
        )
    if options.rate_factor < 0.0 or not math.isfinite(options.rate_factor):
        parser.error(f"--rate-factor must be 0 or above, got {options.rate_factor:g}")
    if options.seed < 0:
        parser.error(f"--seed must be 0 or above, got {options.seed}")
    return options


def main() -> int:
    """Run the demo from the command line."""
    options = parse(None)
    try:
        return guarded("demo", lambda: run_demo(options), failed=1)
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
