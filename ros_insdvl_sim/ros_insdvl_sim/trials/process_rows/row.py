"""A row of processes or networks: the fault as steps, flown and judged.

It is a row of the fault matrix as those of messages are (`insdvl.studies.faults.row`). There the
change edits messages, here it acts on processes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from insdvl.studies.faults.expectation import Check
from insdvl.studies.faults.row import Row
from ros_insdvl_sim.trials.process_rows.flight import DURATION, LiveFlight, Step, live_flight
from ros_insdvl_sim.trials.process_rows.judgement import Flown

AFTER = 10.0  # s of the mission, from the end of a fault, until its consequences should be over

#: Groups of the rows.
PROCESSES, NETWORK = "Processes", "Network"

NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class LiveRow(Row[tuple[Step, ...], Flown]):
    """A fault of processes or networks; the change is the mission with it, step by step.

    Attributes:
        begin: Beginning of the fault [s of the mission]. None: no errors are judged, unless the
            filter was restarted: then the fault lasts from the last output to the next.
        end: End of the fault [s of the mission].
        lost: Number of valid messages that are in no output.
        parameters: Parameters of the filter, on top of those that fit the mission.
        short: Whether the short form has the row.
    """

    begin: float | None = None
    end: float | None = None
    lost: Callable[[LiveFlight], int] = lambda flight: 0
    parameters: Mapping[str, Any] = field(default_factory=lambda: NOTHING)
    short: bool = False

    def window(self, flight: LiveFlight) -> tuple[float, float] | None:
        """Begin and end of the fault [s of the mission], None if no errors are judged."""
        if flight.restart is not None:
            return flight.restart.last_s, flight.restart.first_s
        if self.begin is None or self.end is None:
            return None
        return self.begin, self.end


def judged(row: LiveRow, rate_factor: float) -> dict[str, Any]:
    """Fly a row and judge it; one that cannot be flown to its end is not met, and says why."""
    with live_flight(rate_factor, row.parameters) as flight:
        try:
            for step in row.change:
                step(flight)
            return _document(row, flight)
        except Exception as error:  # one row that cannot be judged must not cost the others
            seen = f"{type(error).__name__}: {error}"
            check = {"expected": "flown to its end", "seen": seen, "met": False}
            return _result(row, [check], 0, {})


def _document(row: LiveRow, flight: LiveFlight) -> dict[str, Any]:
    flown = Flown(flight, row.window(flight))
    if flown.fault is None:
        return _result(row, row.judged_checks(flown), 0, {})
    errors, lost = flown.errors, row.lost(flight)
    checks = row.judged_checks(
        flown,
        (
            _always("output finite", errors.finite),
            _always("stamps rising", errors.rising),
            _always("no valid message lost", lost == 0),
        ),
    )
    begin, end = flown.fault
    numbers = {
        "error_during": errors.rms(begin, end),
        "error_after": errors.rms(end + AFTER, DURATION + 1.0),
        "recovery": errors.recovery(end),
    }
    return _result(row, checks, lost, numbers)


def _always(text: str, met: bool) -> Check[Flown]:
    """What holds under every fault."""
    return Check(text, lambda flown: (text if met else f"not: {text}", met))


def _result(
    row: LiveRow, checks: list[dict[str, Any]], lost: int, numbers: Mapping[str, float | None]
) -> dict[str, Any]:
    """As JSON takes it."""
    return {
        "group": row.group,
        "fault": row.name,
        "error_during": numbers.get("error_during"),
        "error_after": numbers.get("error_after"),
        "recovery": numbers.get("recovery"),
        "lost": lost,
        "checks": checks,
        "met": all(check["met"] for check in checks),
    }
