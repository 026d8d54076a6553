"""What the nodes cost: CPU time per IMU message, memory, and messages that are lost.

    make bench-nodes                        # prints the table; ARGS="--json FILE" keeps it
    make bench-nodes ARGS="--nodes filter bare --rates 1000"
    make bench-nodes ARGS=--stall           # how fast the filter catches up after a stall

Each node runs in a process of its own and is sent IMU messages at a rate, and a DVL message a
second. A message is sent when it is due and the one before is answered (by the odometry; the tuner
has one answer a second). CPU time is that of all threads of the process, the middleware's included:
the median over parts of the run, and half the spread of their middle half.

Beside them stands a bare loop: a node of rclpy with one subscription and one publisher, which
answers bytes with bytes and does no work.
"""

import argparse
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu

from insdvl.messages.make import fill_imu, fill_twist
from insdvl.messages.topics import DVL, IMU, ODOMETRY, PROCESS_NOISE
from insdvl.navigation.events import NS
from ros_insdvl.filter import FilterNode
from ros_insdvl.process.executor import NodeExecutor
from ros_insdvl_sim.trials.environment import isolate

NODES = ("filter", "tuner", "navigator", "bare")
RATES = (100, 1000)  # Hz
PARTS = 7  # of a run, after a first one that is not counted
STALL = 10  # s
PATIENCE = 300.0  # s; only a hang takes so long
SETTLE = 10.0  # s without a message after which the last one has come
LATEST = 1.0  # s after which an answer is not waited for any more
DEEP = QoSProfile(depth=5000)  # reliable
OUTPUT = {"tuner": PROCESS_NOISE}  # of the others it is the odometry
_STAMP = struct.Struct("<iI")  # behind the four bytes of encapsulation


@dataclass(frozen=True)
class Row:
    """What a node cost at a rate.

    Attributes:
        node: The executable.
        rate: Of the IMU [Hz].
        milliseconds: CPU time per IMU message, median over the parts.
        spread: Half the distance between the quartiles [ms].
        megabytes: Largest resident memory of the process.
        sent: IMU messages.
        lost: Of them, by what came back; of the tuner, windows that did not.
    """

    node: str
    rate: int
    milliseconds: float
    spread: float
    megabytes: float
    sent: int
    lost: int


def bare() -> None:
    """The bare loop, until it is interrupted."""
    rclpy.init()
    node = Node("bare", start_parameter_services=False, enable_rosout=False)
    publisher = node.create_publisher(Odometry, ODOMETRY, DEEP)
    answer = bytearray(serialize_message(Odometry(child_frame_id="base_link")))

    def reply(data: bytes) -> None:
        answer[4:12] = data[4:12]
        publisher.publish(bytes(answer))

    node.create_subscription(Imu, IMU, reply, DEEP, raw=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def command(name: str, rate: int) -> list[str]:
    """How a node is started."""
    if name == "bare":
        return [sys.executable, __file__, "--bare"]
    values = {
        "imu.rate": float(rate),
        "initial.mode": "parameters",
        "dvl.type": "geometry_msgs/msg/TwistStamped",
        f"qos_overrides./{IMU}.subscription.reliability": "reliable",
    }
    if name == "navigator":
        values["process_noise.source"] = "external"
    if name == "tuner":
        values = {key: value for key, value in values.items() if key.startswith("qos")}
    arguments = [part for key, value in values.items() for part in ("-p", f"{key}:={value}")]
    return [sys.executable, "-m", f"ros_insdvl.{name}", "--ros-args", *arguments]


def cpu_seconds(pid: int) -> float:
    """CPU time of all threads of a process."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / NS


def largest_memory(pid: int) -> float:
    """Largest resident memory of a process [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    kilobytes = next(line for line in lines if line.startswith("VmHWM")).split()[1]
    return int(kilobytes) / 1e3


def wait_for(condition: Callable[[], bool], what: str, process: "subprocess.Popen[bytes]") -> None:
    """Wait until something is so.

    Raises:
        SystemExit: It never is, or the process has ended.
    """
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if process.poll() is not None or time.monotonic() > deadline:
            raise SystemExit(f"nodes: no {what}; exit code of the node: {process.poll()}")
        time.sleep(0.01)


class Peer:
    """Sends what the sensors send, and counts what comes back."""

    def __init__(self, node: Node, output: str, depth: int = 5000) -> None:
        qos = QoSProfile(depth=depth)
        self.imu: Publisher = node.create_publisher(Imu, IMU, qos)
        self.dvl: Publisher = node.create_publisher(TwistStamped, DVL, DEEP)
        self._answers = output == ODOMETRY
        self._type = Odometry if self._answers else Imu
        self._heard: Subscription = node.create_subscription(
            self._type, output, lambda data: None, qos, raw=True
        )
        imu = Imu()
        imu.header.frame_id = "imu_link"
        fill_imu(imu, 0, [0.0, 0.0, 9.80], [0.0, 0.0, 0.0])
        self._data = bytearray(serialize_message(imu))
        self._random = np.random.default_rng(1)
        self._numbers = len(self._data) - 37 * 8  # where they begin
        self._ping = TwistStamped()
        self.sent = 0
        self.heard = 0

    def send(self, count: int, rate: int, *, answered: bool = True) -> None:
        """Send IMU messages at a rate, and what belongs between them.

        Args:
            count: Number of messages.
            rate: Of the messages [Hz].
            answered: Whether each one is to be answered before the next.
        """
        step_ns, start_ns = NS // rate, 1_700_000_000 * NS
        noise = self._random.normal(0.0, 0.01, (count, 6))
        began = time.monotonic()
        for k in range(count):
            self.sent += 1
            stamp_ns = start_ns + self.sent * step_ns
            _STAMP.pack_into(self._data, 4, *divmod(stamp_ns, NS))
            w, f = noise[k, :3], noise[k, 3:] + (0.0, 0.0, 9.8)
            struct.pack_into("<3d", self._data, self._numbers + 13 * 8, *w)
            struct.pack_into("<3d", self._data, self._numbers + 25 * 8, *f)
            self.imu.publish(bytes(self._data))
            if self.sent % rate == 0:
                fill_twist(self._ping, stamp_ns, self._random.normal(0.0, 0.02, 3))
                self.dvl.publish(self._ping)
            if answered:
                self.await_answer()
            if (ahead := began + (k + 1) / rate - time.monotonic()) > 0.0:
                time.sleep(ahead)

    def await_answer(self) -> None:
        """Wait until the node, where it answers each message, has done so.

        On a busy machine it would else find many messages waiting, which cost it less.
        """
        deadline = time.monotonic() + LATEST
        self.take()
        while self._answers and self.heard < self.sent and time.monotonic() < deadline:
            time.sleep(1e-4)
            self.take()

    def take(self) -> None:
        """Count what has come."""
        handle = self._heard.handle
        with handle:
            while handle.take_message(self._type, True) is not None:
                self.heard += 1

    def settle(self, expected: int) -> None:
        """Wait for the last messages, as long as some come."""
        changed, before = time.monotonic(), self.heard
        while self.heard < expected and time.monotonic() - changed < SETTLE:
            self.take()
            if self.heard != before:
                changed, before = time.monotonic(), self.heard
            time.sleep(0.01)


def measured(name: str, rate: int, seconds: float, logs: Path) -> Row:
    """The row of a node at a rate."""
    node = Node("sensors", start_parameter_services=False)
    output = OUTPUT.get(name, ODOMETRY)
    peer = Peer(node, output)
    with (logs / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(command(name, rate), stdout=log, stderr=subprocess.STDOUT)
    try:
        wait_for(lambda: peer.imu.get_subscription_count() > 0, f"subscription of {IMU}", process)
        wait_for(lambda: node.count_publishers(output) > 0, f"publisher of {output}", process)
        count, costs = round(rate * seconds), []
        peer.send(count, rate)
        for _ in range(PARTS):
            before = cpu_seconds(process.pid)
            peer.send(count, rate)
            costs.append((cpu_seconds(process.pid) - before) / count * 1e3)
        # Of the tuner's windows, one a second, the first need its 200 samples.
        tuned = peer.sent // rate - max(200 // rate, 1)
        expected = tuned if name == "tuner" else peer.sent
        peer.settle(expected)
        low, middle, high = np.percentile(costs, [25.0, 50.0, 75.0]).tolist()
        return Row(
            name,
            rate,
            middle,
            (high - low) / 2.0,
            largest_memory(process.pid),
            peer.sent,
            max(expected - peer.heard, 0),
        )
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
        node.destroy_node()


def stall() -> str:
    """How a filter fares that does nothing for `STALL` seconds of an IMU at 1 kHz.

    It lives in this process and is not turned meanwhile. What the sensors send is CPU time of this
    process too, but before the filter is turned.
    """
    rate = RATES[-1]
    values = {
        "imu.rate": float(rate),
        "initial.mode": "parameters",
        "dvl.type": "geometry_msgs/msg/TwistStamped",
        f"qos_overrides./{IMU}.subscription.reliability": "reliable",
    }
    node = Node("sensors", start_parameter_services=False)
    peer = Peer(node, ODOMETRY, depth=2 * STALL * rate)
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    filter_node = FilterNode(parameter_overrides=overrides)
    executor = NodeExecutor()
    executor.add_node(filter_node)
    while peer.imu.get_subscription_count() == 0 or node.count_publishers(ODOMETRY) == 0:
        executor.spin_once(0.01)
    count = STALL * rate
    peer.send(count, rate, answered=False)
    began, used = time.monotonic(), time.process_time()
    while peer.heard < count and time.monotonic() - began < PATIENCE:
        executor.spin_once(1.0)
        peer.take()
    took, used = time.monotonic() - began, time.process_time() - used
    executor.let_go()
    filter_node.destroy_node()
    node.destroy_node()
    return (
        f"a stall of {STALL} s at {rate} Hz: {count - peer.heard} of {count} lost, caught up at "
        f"{STALL / took:.1f} times real time, with {used / count * 1e3:.3f} ms of CPU per message"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", nargs="+", choices=NODES, default=NODES)
    parser.add_argument("--rates", nargs="+", type=int, default=RATES, help="of the IMU [Hz]")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each part of a run")
    parser.add_argument("--json", type=Path, help="keep the rows in this file")
    parser.add_argument("--stall", action="store_true", help="a stall, in place of the table")
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.bare:
        bare()
        return 0
    isolate()
    rows = []
    with tempfile.TemporaryDirectory(prefix="insdvl-bench-") as logs:
        os.environ["ROS_LOG_DIR"] = logs
        rclpy.init()
        if options.stall:
            print(stall())
            rclpy.try_shutdown()
            return 0
        print("node        rate   CPU per IMU message   memory   sent     lost")
        for rate in options.rates:
            for name in options.nodes:
                row = measured(name, rate, options.seconds, Path(logs))
                rows.append(row)
                print(
                    f"{row.node:10s} {row.rate:5d}   {row.milliseconds:.3f} +- {row.spread:.3f} ms"
                    f"      {row.megabytes:4.0f} MB  {row.sent:7d}  {row.lost:4d}",
                    flush=True,
                )
        rclpy.try_shutdown()
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
