"""The first rows of the table of nodes, flown as printed: a newcomer's filter heads right."""

import math
import re
import shlex
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graphs import Graph
from nav_msgs.msg import Odometry
from ros_messages import stamp_of

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "nodes.md"
ROWS = ("simulator", "tuner", "filter")
SAMPLES = 400  # 4 s at 100 Hz: as printed, the simulator flies in real time
DEADLINE = 300.0  # s; only a hang takes as long, even where kernels are compiled first


def commands(row: str) -> list[str]:
    """The commands in a row of the table: with a full Jazzy, and with the wheels alone."""
    (line,) = re.findall(rf"^\| {row} \|(.*)\|$", PAGE.read_text(), re.MULTILINE)
    return re.findall(r"`([^`]+)`", line)


def heading(odometry: Odometry) -> float:
    q = odometry.pose.pose.orientation
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))


class Terminals(Graph):
    """The processes that a reader of the page starts, and what they publish."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.truth = self.keep(Odometry, "ground_truth/odometry")
        self.filtered = self.keep(Odometry, "odometry/filtered")
        self.untold = self.keep(Odometry, "untold/odometry/filtered")
        self.diagnostics = self.keep(DiagnosticArray, "/diagnostics")

    def pairs(self) -> list[tuple[Odometry, Odometry]]:
        """Odometry and truth of the same stamps, in their order."""
        truth = {stamp_of(message): message for message in self.truth}
        return [(m, truth[stamp_of(m)]) for m in self.filtered if stamp_of(m) in truth]

    def start(self, row: str) -> None:
        prefix = Path(get_package_prefix("ros_insdvl"))
        self.run(row, shlex.split(commands(row)[1].replace(".venv/", f"{prefix}/")))

    def start_untold(self) -> None:
        """A filter of its own namespace without any argument about its start."""
        program = Path(get_package_prefix("ros_insdvl")) / "lib/ros_insdvl/filter"
        remaps = [f"{topic}:=/{topic}" for topic in ("imu/data_raw", "dvl/velocity")]
        arguments = [part for name in ("__ns:=/untold", *remaps) for part in ("-r", name)]
        self.run("untold", [str(program), "--ros-args", *arguments])

    def run(self, name: str, command: list[str]) -> None:
        with (self.folder / f"{name}.log").open("wb") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))

    def status(self, name: str) -> DiagnosticStatus | None:
        """The last status of a name."""
        found = [s for array in self.diagnostics for s in array.status if s.name == name]
        return found[-1] if found else None

    def check(self) -> None:
        assert all(process.poll() is None for process in self.processes), self.logs()

    def logs(self) -> str:
        return "\n".join(path.read_text() for path in sorted(self.folder.glob("*.log")))

    def close(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGINT)
        for process in self.processes:
            process.wait(DEADLINE)
        super().close()


@pytest.fixture
def terminals(managed: Any, tmp_path: Path) -> Terminals:
    return managed(Terminals(tmp_path))


@pytest.mark.parametrize(
    "row", [*ROWS, "both in one process", "play a rosbag2", "bad network", "live table"]
)
def test_both_columns_run_the_same(row: str) -> None:
    jazzy, wheels = commands(row)
    assert re.sub(r"^ros2 run (\w+) (\w+)", r".venv/lib/\1/\2", jazzy) == wheels


def test_the_first_rows_navigate_the_right_way(terminals: Terminals) -> None:
    """The printed filter knows its heading; one without arguments says what tells it."""
    for row in ROWS:
        terminals.start(row)
    terminals.start_untold()

    def untold_says() -> bool:
        status = terminals.status("untold/insdvl_filter: initialisation")
        return status is not None and "heading unknown" in status.message

    def flown() -> bool:
        terminals.check()
        enough = len(terminals.filtered) >= SAMPLES and len(terminals.pairs()) >= SAMPLES
        return enough and untold_says()

    terminals.until(flown, "the flight")
    pairs = terminals.pairs()
    for filtered, truth in pairs[0], pairs[SAMPLES // 2], pairs[-1]:
        error = math.remainder(heading(filtered) - heading(truth), 2 * math.pi)
        sigma = math.sqrt(filtered.pose.covariance[35])
        assert sigma < math.radians(5.0)
        assert abs(error) < 3 * sigma
    status = terminals.status("untold/insdvl_filter: initialisation")
    assert status is not None and status.level == DiagnosticStatus.WARN
    assert "set initial.mode:=topic" in status.message  # the argument of the printed row
    assert terminals.untold[-1].pose.covariance[35] > math.radians(60.0) ** 2
    assert "started: heading unknown" in terminals.logs()
