"""Rows of the machine: shared memory, files and logs that cannot be written."""

import os
import resource
import signal
import time
from pathlib import Path

from insdvl.messages.topics import IMU
from insdvl.studies.faults.expectation import Check
from ros_insdvl_sim.trials.process_rows.checks import error_below, lost_of_all_sent
from ros_insdvl_sim.trials.process_rows.flight import LiveFlight, Step
from ros_insdvl_sim.trials.process_rows.judgement import Flown
from ros_insdvl_sim.trials.process_rows.row import AFTER, PROCESSES, LiveRow
from ros_insdvl_sim.trials.process_rows.steps import (
    at,
    complaint,
    finish,
    recovery,
    start_filter,
    start_simulator,
    the_fault_begins,
)

CAUSE = "state file"


# ---------------------------------------------------------------- shared memory


def _segments(pid: int) -> set[Path]:
    """The middleware's segments of shared memory that a process has open."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {Path(line.split()[5]) for line in lines if "/dev/shm/fastrtps_" in line}


def _kill_three_filters(flight: LiveFlight) -> None:
    of_the_witness, used = _segments(os.getpid()), set()
    for k in range(3):
        name = f"killed {k}"
        flight.start_filter(name)
        used |= _segments(flight.processes.process(name).pid)
        flight.processes.end(name, signal.SIGKILL)
    # The filters had opened those of the witness as well.
    flight.notes["left"] = sum(segment.exists() for segment in used - of_the_witness)


def _segments_are_left(flown: Flown) -> tuple[str, bool]:
    left = flown.flight.notes["left"]
    return f"{left} segments left", left > 0


def _nothing_is_lost(flown: Flown) -> tuple[str, bool]:
    published, sent = len(flown.flight.odometry), flown.flight.sent[IMU]
    return f"odometry {published} of {sent}", published == sent


# ---------------------------------------------------------------- the state file


def _keep_state_in(folder: str) -> Step:
    def step(flight: LiveFlight) -> None:
        file = flight.folder / folder / "state"
        file.parent.mkdir(exist_ok=True)
        flight.notes["file"] = file
        flight.parameters["state_file"] = str(file)

    return step


def _move_folder_away(flight: LiveFlight) -> None:
    folder: Path = flight.notes["file"].parent
    folder.rename(folder.with_name("away"))


def _make_folder_again(flight: LiveFlight) -> None:
    flight.notes["file"].parent.mkdir()


def _limit_files(flight: LiveFlight, size: int | None) -> None:
    """Largest file that the filter may write, None for no limit."""
    pid = flight.processes.process("filter").pid
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (most if size is None else size, most))


def _without_state_file(take_away: Step, give_back: Step) -> tuple[Step, ...]:
    """A mission in which the state file cannot be written from 15 s to 30 s."""

    def give_back_and_look(flight: LiveFlight) -> None:
        flight.notes["complaint"] = flight.witness.status("/insdvl_filter", CAUSE).message
        give_back(flight)
        flight.notes["given back"] = time.time()

    return (
        start_filter(),
        start_simulator(),
        at(15.0),
        take_away,
        the_fault_begins,
        at(30.0),
        complaint(CAUSE),
        give_back_and_look,
        recovery(CAUSE),
        finish(),
    )


def _written_again(flown: Flown) -> tuple[str, bool]:
    notes = flown.flight.notes
    file: Path = notes["file"]
    written = file.is_file() and file.stat().st_mtime > notes["given back"]
    complaint_ = notes["complaint"].replace(f"{file.parent}/", "")[:60]
    result = "new" if written else "not written"
    return f"{complaint_}; then recovered, the file {result}", written


STATE_FILE_CHECKS = (
    Check("a warning, navigation continues, the file is written again, recovered", _written_again),
    error_below(1.0, AFTER),
)


# ---------------------------------------------------------------- the log


def _line_about_the_log(flown: Flown) -> tuple[str, bool]:
    text = flown.flight.processes.text("filter")
    line = next((x for x in text.splitlines() if "no log file" in x), "")
    return line[:90] or "no line", bool(line)


ROWS = (
    LiveRow(
        PROCESSES,
        "three filters killed with SIGKILL, their shared memory left over",
        (_kill_three_filters, start_filter(), start_simulator(), finish()),
        (
            Check("they leave segments behind, else the row proves nothing", _segments_are_left),
            Check("the next filter starts and loses nothing", _nothing_is_lost),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=10.0,
        lost=lost_of_all_sent,
    ),
    LiveRow(
        PROCESSES,
        "the folder of the state file is gone from 15 s to 30 s",
        (_keep_state_in("states"), *_without_state_file(_move_folder_away, _make_folder_again)),
        STATE_FILE_CHECKS,
        begin=15.0,
        end=30.0,
        lost=lost_of_all_sent,
    ),
    LiveRow(
        PROCESSES,
        "from 15 s to 30 s no file of the filter can grow, as on a full disk",
        (
            _keep_state_in("states"),
            *_without_state_file(
                lambda flight: _limit_files(flight, 0), lambda flight: _limit_files(flight, None)
            ),
        ),
        STATE_FILE_CHECKS,
        begin=15.0,
        end=30.0,
        lost=lost_of_all_sent,
    ),
    LiveRow(
        PROCESSES,
        "the folder of the logs cannot be made",
        (
            start_filter(environment={"ROS_LOG_DIR": "/dev/null/log"}),
            start_simulator(),
            finish(),
        ),
        (
            Check("a line says so and navigation continues", _line_about_the_log),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=10.0,
        lost=lost_of_all_sent,
    ),
)
