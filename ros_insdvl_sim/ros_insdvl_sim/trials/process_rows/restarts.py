"""Rows of nodes that end, restart, or run twice."""

import signal

from insdvl.messages.topics import IMU
from insdvl.studies.faults.expectation import Check
from insdvl.studies.faults.rows.base import LEVELLING
from ros_insdvl_sim.trials.names import FILTER
from ros_insdvl_sim.trials.process_rows.checks import complained, error_below, lost_in_life
from ros_insdvl_sim.trials.process_rows.flight import LiveFlight, Restart
from ros_insdvl_sim.trials.process_rows.judgement import Flown, first_sigmas
from ros_insdvl_sim.trials.process_rows.row import AFTER, PROCESSES, LiveRow
from ros_insdvl_sim.trials.process_rows.steps import (
    at,
    complaint,
    end,
    finish,
    kill,
    recovery,
    restart_filter,
    start_filter,
    start_simulator,
    the_fault_begins,
)

MOST_SIGMAS = 5.0
LEVELLING_SAMPLES = 100  # its first second, without output


def _restart_of(flown: Flown) -> tuple[Restart, str, bool]:
    """The restart, how long the filter was away, and whether it continued from its state."""
    restart = flown.flight.restart
    if restart is None:
        raise ValueError("the row restarts no filter")
    resumed = "from the state at stamp" in flown.flight.processes.text("filter again")
    return restart, f"away from {restart.last_s:.1f} to {restart.first_s:.1f} s", resumed


def _says_that_it_continues(flown: Flown) -> tuple[str, bool]:
    _, away, resumed = _restart_of(flown)
    return f"{away}; {'said so' if resumed else 'said nothing'}", resumed


def _first_errors(flown: Flown) -> tuple[str, bool]:
    restart, _, _ = _restart_of(flown)
    ratio = first_sigmas(flown.flight, restart.first_index)
    return f"largest of the first second {ratio:.1f} σ", ratio < MOST_SIGMAS


def _levels(flown: Flown) -> tuple[str, bool]:
    restart, away, resumed = _restart_of(flown)
    seen = f"{away}, {'from a state' if resumed else 'from the beginning'}"
    return seen, not resumed and restart.first_s - restart.last_s > 5.5


def _forget_the_first_mission(flight: LiveFlight) -> None:
    flight.witness.until_reported("/insdvl_filter", times=2)  # by then all of it has arrived
    flight.notes["before"] = len(flight.odometry)
    flight.odometry.clear()
    flight.truth.clear()


def _one_jump(flown: Flown) -> tuple[str, bool]:
    text = flown.flight.processes.text("filter")
    lines = [line for line in text.splitlines() if "stamps went from" in line]
    return f"{len(lines)} lines of it", len(lines) == 1


def _all_of_the_new_time(flown: Flown) -> tuple[str, bool]:
    count = flown.flight.sent[IMU] - LEVELLING_SAMPLES
    published, before = len(flown.flight.odometry), flown.flight.notes["before"]
    return f"{published} of {count}; {before} before", published == count


def _start_a_second_filter(flight: LiveFlight) -> None:
    the_fault_begins(flight)
    flight.processes.start("second", FILTER, flight.filter_parameters())


#: How a filter is ended: signals, the time between them [s], and the name in the result.
_ENDS = (
    ((signal.SIGTERM,), 0.0, "SIGTERM"),
    ((signal.SIGINT,), 0.0, "SIGINT"),
    *(
        ((signal.SIGINT, signal.SIGINT), gap_ms / 1000.0, f"SIGINT twice, {gap_ms} ms apart")
        for gap_ms in (0, 5, 50)
    ),
)


def _end_filters(flight: LiveFlight) -> None:
    """End one filter after the other, each in its own way."""
    start_filter(_ENDS[0][2])(flight)
    start_simulator()(flight)
    flight.until_stamp(5.0)
    for k, (signals, gap, name) in enumerate(_ENDS):
        if k:
            start_filter(name)(flight)
        end(name, *signals, gap=gap)(flight)


def _all_end_cleanly(flown: Flown) -> tuple[str, bool]:
    codes = flown.flight.codes
    traces = [name for name in codes if "Traceback" in flown.flight.processes.text(name)]
    seen = ", ".join(f"{name} {code}" for name, code in codes.items())
    if traces:
        seen += f", traceback of {', '.join(traces)}"
    return seen, not any(codes.values()) and not traces


ROWS = (
    LiveRow(
        PROCESSES,
        "the filter is killed at 30 s and started again, with a state file",
        (
            lambda flight: flight.parameters.update(state_file=str(flight.folder / "state")),
            start_filter(),
            start_simulator(),
            restart_filter(30.0, 35.0),
            finish(),
        ),
        (
            Check("it says that it continues from its state", _says_that_it_continues),
            Check(f"its first errors are within {MOST_SIGMAS:g} σ", _first_errors),
            error_below(1.0, AFTER),
        ),
        lost=lost_in_life(),
    ),
    LiveRow(
        PROCESSES,
        "the filter is killed at 30 s and started again, without a state file",
        (start_filter(), start_simulator(), restart_filter(30.0, 35.0), finish()),
        (
            Check("it starts as initial.mode says, by levelling, which takes a second", _levels),
            error_below(1.0, AFTER),
        ),
        lost=lost_in_life(),
        parameters=LEVELLING,
    ),
    LiveRow(
        PROCESSES,
        "the simulator is killed at 45 s and started again: stamps jump back",
        (
            start_filter(),
            start_simulator(),
            at(45.0),
            kill("simulator"),
            _forget_the_first_mission,
            start_simulator(name="simulator again"),
            finish("simulator again"),
        ),
        (
            Check("one time jump, and a line that says so", _one_jump),
            Check(
                "every sample of the new time but levelling's is in the output",
                _all_of_the_new_time,
            ),
            error_below(1.0, AFTER),
        ),
        begin=0.0,
        end=5.0,
        lost=lost_in_life(),
        parameters=LEVELLING,
    ),
    LiveRow(
        PROCESSES,
        "a second filter of the same name for some seconds",
        (
            start_filter(),
            start_simulator(),
            at(5.0),
            _start_a_second_filter,
            complaint("connections"),
            end("second", signal.SIGINT),
            recovery("connections"),
            finish(),
        ),
        (
            complained(
                "reported in the status `connections` within 10 s of its start, and recovered",
                "connections",
                10.0,
                word="insdvl_filter",
            ),
        ),
    ),
    LiveRow(
        PROCESSES,
        "SIGTERM, SIGINT, and SIGINT twice, under load",
        (_end_filters,),
        (Check("ends with 0 and without a traceback", _all_end_cleanly),),
    ),
)
