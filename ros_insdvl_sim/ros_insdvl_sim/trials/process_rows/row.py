"""A row of processes or networks: the fault as steps, and what is expected.

The language is that of the rows of messages (`insdvl.studies.faults.rows`): a name, a change,
checks and the time of the fault. There the change edits messages, here it acts on processes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from insdvl.studies.faults.expectation import Check
from ros_insdvl_sim.trials.process_rows.flight import DURATION, LiveFlight, Step, live_flight
from ros_insdvl_sim.trials.process_rows.judgement import Flown

AFTER = 10.0  # s of the mission, from the end of a fault, until its consequences should be over

#: Parts of the page.
GROUP_PROCESSES, GROUP_NETWORK = "Processes", "Network"

NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Row:
    """A fault and what is expected.

    Attributes:
        group: Part of the page.
        name: What happens, in words.
        change: The mission and the fault in it, step by step.
        checks: What is expected, beside what always holds.
        begin: Of the fault [s of the mission]. None: no errors are judged, unless the filter was
            restarted: then the fault lasts from the last output to the next.
        end: Of the fault [s of the mission].
        lost: Number of valid messages that are in no output.
        parameters: Of the filter, on top of those that fit the mission.
        short: Whether the short form has the row.
    """

    group: str
    name: str
    change: tuple[Step, ...]
    checks: tuple[Check[Flown], ...]
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


def judged(row: Row, rate_factor: float) -> dict[str, Any]:
    """A row, flown and judged; one that cannot be flown to its end is not met, and says why."""
    with live_flight(rate_factor, row.parameters) as flight:
        try:
            for step in row.change:
                step(flight)
            return _document(row, flight)
        except Exception as error:  # one row that cannot be judged must not cost the others
            seen = f"{type(error).__name__}: {error}"
            check = {"expected": "flown to its end", "seen": seen, "met": False}
            return _result(row, [check], 0, {})


def _document(row: Row, flight: LiveFlight) -> dict[str, Any]:
    flown = Flown(flight, row.window(flight))
    checks = [check.document(flown) for check in row.checks]
    if flown.fault is None:
        return _result(row, checks, 0, {})
    errors, lost = flown.errors, row.lost(flight)
    for text, met in (
        ("output finite", errors.finite),
        ("stamps rising", errors.rising),
        ("no valid message lost", lost == 0),
    ):
        seen = text if met else f"not: {text}"
        checks.append({"expected": text, "seen": seen, "met": met, "always": True})
    begin, end = flown.fault
    numbers = {
        "error_during": errors.rms(begin, end),
        "error_after": errors.rms(end + AFTER, DURATION + 1.0),
        "recovery": errors.recovery(end),
    }
    return _result(row, checks, lost, numbers)


def _result(
    row: Row, checks: list[dict[str, Any]], lost: int, numbers: Mapping[str, float | None]
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
