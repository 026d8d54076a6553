"""The first rows of the README, flown as printed: a newcomer's filter heads the right way."""

import math
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from insdvl.messages.convert import stamp_ns

README = Path(__file__).parents[2] / "README.md"
ROWS = ("simulator", "tuner", "filter")
SAMPLES = 400  # 4 s at 100 Hz: as printed, the simulator flies in real time
DEADLINE = 300.0  # s; only a hang takes as long, even where kernels are compiled first


def commands(row: str) -> list[str]:
    """The commands in a row of the README's table: with a full Jazzy, and with the wheels alone."""
    (line,) = re.findall(rf"^\| {row} \|(.*)\|$", README.read_text(), re.MULTILINE)
    return re.findall(r"`([^`]+)`", line)


def heading(odometry: Odometry) -> float:
    q = odometry.pose.pose.orientation
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))


class Terminals:
    """The processes that a reader of the README starts, and what they publish."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.truth: dict[int, Odometry] = {}
        self.filtered: dict[int, Odometry] = {}
        self.context = Context()
        self.context.init()
        self.node = Node("reader", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        for topic, received in (
            ("ground_truth/odometry", self.truth),
            ("odometry/filtered", self.filtered),
        ):
            self.node.create_subscription(
                Odometry,
                topic,
                lambda message, received=received: received.update(
                    {stamp_ns(message.header): message}
                ),
                QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE),
            )

    def start(self, row: str) -> None:
        prefix = Path(get_package_prefix("ros_insdvl"))
        command = commands(row)[1].replace(".venv/", f"{prefix}/")
        with (self.folder / f"{row}.log").open("wb") as log:
            self.processes.append(
                subprocess.Popen(shlex.split(command), stdout=log, stderr=subprocess.STDOUT)
            )

    def until(self, condition: Callable[[], bool]) -> None:
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < DEADLINE, self.logs()
            assert all(process.poll() is None for process in self.processes), self.logs()
            self.executor.spin_once(timeout_sec=0.1)

    def logs(self) -> str:
        return "\n".join(path.read_text() for path in sorted(self.folder.glob("*.log")))

    def close(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGINT)
        for process in self.processes:
            process.wait(DEADLINE)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.shutdown()


@pytest.fixture
def terminals(tmp_path: Path) -> Iterator[Terminals]:
    made = Terminals(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize("row", [*ROWS, "play a rosbag2", "bad network", "live table"])
def test_both_columns_run_the_same(row: str) -> None:
    jazzy, wheels = commands(row)
    assert re.sub(r"^ros2 run (\w+) (\w+)", r".venv/lib/\1/\2", jazzy) == wheels


def test_the_first_rows_navigate_the_right_way(terminals: Terminals) -> None:
    for row in ROWS:
        terminals.start(row)
    terminals.until(lambda: len(terminals.truth.keys() & terminals.filtered.keys()) >= SAMPLES)
    stamps = sorted(terminals.truth.keys() & terminals.filtered.keys())
    for stamp in stamps[0], stamps[SAMPLES // 2], stamps[-1]:
        filtered, truth = terminals.filtered[stamp], terminals.truth[stamp]
        error = math.remainder(heading(filtered) - heading(truth), 2 * math.pi)
        sigma = math.sqrt(filtered.pose.covariance[35])
        assert sigma < math.radians(5.0)
        assert abs(error) < 3 * sigma
