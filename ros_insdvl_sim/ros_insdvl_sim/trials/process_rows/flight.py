"""A mission flown by real processes, and everything that was seen of it."""

import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from nav_msgs.msg import Odometry

from insdvl.messages.topics import BY_NAME, DVL, IMU, TRUTH
from insdvl.navigation.events import NS
from insdvl.parameters.declaration import flatten
from insdvl.studies.faults.flight import parameters_of
from insdvl.studies.faults.stream import Sensors, stream_of
from ros_insdvl.status.heard import OK, Change
from ros_insdvl_sim.trials.names import (
    FILTER,
    FILTER_NODE,
    ODOMETRY,
    RELAY,
    RELAY_NODE,
    SIMULATOR,
    TUNER,
    TUNER_NODE,
)
from ros_insdvl_sim.trials.processes import Processes, lossless, sent_by
from ros_insdvl_sim.trials.witness import Witness, stamp_of

DURATION = 60.0  # s of the missions
START_S = 1000.0  # stamp of the start
SEED = 1


def _is_of_mission(name: str) -> bool:
    """Whether a parameter describes where, and how well known, the mission starts."""
    told = name in ("initial.mode", "initial.rpy", "initial.velocity", "origin.height")
    return told or (name.startswith("initial.") and name.endswith("_std"))


class Restart(NamedTuple):
    """A filter that ended, and the next one.

    Attributes:
        last_s: When the odometry of the one ended [s of the mission].
        first_s: When that of the next began [s of the mission].
        first_index: Of its first odometry.
    """

    last_s: float
    first_s: float
    first_index: int


class LiveFlight:
    """The processes of a mission, and a witness that keeps the odometry and the truth.

    Attributes:
        processes: The processes, by name.
        folder: For files of the row.
        rate_factor: Speed against real time.
        parameters: Of the filter, on top of those that fit the mission.
        witness: Listens.
        odometry: Stamp and bytes of everything that the filter published, in the order of arrival.
        truth: The true odometry, by stamp.
        sent: Messages by topic that the simulator sent, at the end.
        since: When the fault began, on the monotonic clock [s].
        complaints: The first complaint of each cause that was waited for.
        restart: Of the filter.
        codes: Exit codes of processes that were ended.
        notes: Anything else that a step saw, and a check judges.
    """

    def __init__(
        self,
        processes: Processes,
        witness: Witness,
        folder: Path,
        rate_factor: float,
        parameters: Mapping[str, Any],
    ) -> None:
        self.processes = processes
        self.witness = witness
        self.folder = folder
        self.rate_factor = rate_factor
        self.parameters = dict(parameters)
        self.odometry: list[tuple[int, bytes]] = []
        self.truth: dict[int, bytes] = {}
        self.sent: dict[str, int] = {}
        self.since = time.monotonic()
        self.complaints: dict[str, Change] = {}
        self.restart: Restart | None = None
        self.codes: dict[str, int] = {}
        self.notes: dict[str, Any] = {}
        self._newest_ns = 0
        self._starting: dict[str, tuple[str, int]] = {}  # node, and its reports before
        self._process_of: dict[str, subprocess.Popen[bytes]] = {}  # the last one of each node
        witness.hear(Odometry, ODOMETRY, lambda data: self.odometry.append((stamp_of(data), data)))
        witness.hear(Odometry, TRUTH, self._on_truth)

    def _on_truth(self, data: bytes) -> None:
        self._newest_ns = stamp_of(data)
        self.truth[self._newest_ns] = data

    # Processes

    def filter_parameters(self) -> dict[str, Any]:
        """Parameters of the filter, those of the mission as in the rows of messages."""
        sensors = Sensors(start_ns=round(START_S * NS))
        mission = stream_of(sensors, SEED, 2.0).mission
        values = flatten(parameters_of(mission, sensors, SEED, {}))
        return {
            **{name: value for name, value in values.items() if _is_of_mission(name)},
            "dvl.type": BY_NAME[DVL].types[0],  # subscribed before there is a publisher
            **lossless(f"/{IMU}", f"/{DVL}"),
            **self.parameters,
        }

    def start_filter(self, name: str, environment: Mapping[str, str] | None = None) -> None:
        """Start a filter, and wait until all nodes are in the graph."""
        self._start(name, FILTER, FILTER_NODE, self.filter_parameters(), environment)
        self._until_started()

    def start_tuner(self, name: str, parameters: Mapping[str, Any]) -> None:
        """Start a tuner, and wait until all nodes are in the graph."""
        self._start(name, TUNER, TUNER_NODE, {**lossless(f"/{IMU}"), **parameters})
        self._until_started()

    def start_relay(self, parameters: Mapping[str, Any]) -> None:
        """Start a relay; the filter that is started next waits for it."""
        links = lossless(f"/sent/{IMU}", f"/sent/{DVL}")
        self._start("relay", RELAY, RELAY_NODE, {**links, **parameters})

    def _start(
        self,
        name: str,
        program: tuple[str, str],
        node: str,
        parameters: Mapping[str, Any],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        # An earlier one of this name has ended: reports from now on are those of the new one.
        self._starting[name] = node, self.witness.diagnostics.report(node).count
        process = self.processes.start(name, program, parameters, environment=environment)
        self._process_of[node] = process

    def _until_started(self) -> None:
        """Wait for the first report of all that were started."""

        def started() -> bool:
            self.processes.check(*self._starting)
            report = self.witness.diagnostics.report
            return all(report(node).count > before for node, before in self._starting.values())

        self.witness.until(started, f"the start of {', '.join(self._starting)}")
        self._starting.clear()

    def start_simulator(
        self,
        subscribers: int,
        name: str,
        parameters: Mapping[str, Any],
        remaps: Mapping[str, str] | None = None,
    ) -> None:
        """Start the simulator; it plays when so many subscribers of its IMU are there."""
        values = {
            "duration": DURATION,
            "seed": SEED,
            "rate_factor": self.rate_factor,
            "start_stamp": START_S,
            "min_subscribers": subscribers,
            "noise.profile": "constant",
        }
        self.processes.start(name, SIMULATOR, {**values, **parameters}, remaps)

    # Time

    def until_stamp(self, seconds: float) -> None:
        """Wait for a time of the mission [s]."""
        stamp_ns = round((START_S + seconds) * NS)
        self.witness.until(lambda: self._newest_ns >= stamp_ns, f"{seconds:g} s of the mission")

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Hold the simulator, so that the start of a program takes no time of the mission."""
        process = self.processes.process("simulator")
        process.send_signal(signal.SIGSTOP)
        self.witness.until_settled(lambda: len(self.odometry), *self._reporting())
        try:
            yield
        finally:
            process.send_signal(signal.SIGCONT)

    def finish(self, name: str) -> None:
        """Wait until a simulator has sent its mission, and all of it has arrived."""
        process = self.processes.process(name)
        self.witness.until(lambda: process.poll() is not None, "the end of the mission")
        self.witness.until_settled(
            lambda: (
                len(self.odometry),
                [self.witness.diagnostics.report(node).values for node in self._reporting()],
            ),
            *self._reporting(),
        )
        self.sent = sent_by(self.processes.text(name))

    def _reporting(self) -> list[str]:
        """Nodes that run: once their reports stay the same, nothing more comes."""
        return [node for node, process in self._process_of.items() if process.poll() is None]

    # What the filter says

    def count(self, key: str, node: str = FILTER_NODE) -> int:
        """A count in the last diagnostics of a node."""
        return self.witness.diagnostics.count(node, key)

    def until_complaint(self, cause: str) -> None:
        """Wait until the filter has complained of a cause since the fault began."""

        def found() -> bool:
            for change in self.witness.diagnostics.changes:
                wrong = change.status.level != OK and change.at >= self.since
                if wrong and (change.node, change.cause) == (FILTER_NODE, cause):
                    self.complaints[cause] = change
                    return True
            return False

        self.witness.until(found, f"a complaint of '{cause}'")

    def until_recovered(self, cause: str) -> None:
        """Wait until a status of the filter is well."""
        self.witness.until(
            lambda: self.witness.status(FILTER_NODE, cause).level == OK,
            f"the recovery of '{cause}'",
        )


@contextmanager
def live_flight(rate_factor: float, parameters: Mapping[str, Any]) -> Iterator[LiveFlight]:
    """A graph of its own, and a folder for its files."""
    with tempfile.TemporaryDirectory(prefix="insdvl-faults-") as folder:
        logs = Path(folder) / "logs"
        logs.mkdir()
        with (
            closing(Witness()) as witness,
            Processes(logs, {"ROS_LOG_DIR": str(logs)}) as processes,
        ):
            yield LiveFlight(processes, witness, Path(folder), rate_factor, parameters)


Step = Callable[[LiveFlight], None]
