"""The rows of messages and time, flown and judged."""

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from insdvl.navigation.events import NS
from insdvl.studies.faults.checks import Pair, always
from insdvl.studies.faults.flight import Flight, fly, parameters_of
from insdvl.studies.faults.rows import ROWS
from insdvl.studies.faults.rows.base import FlightRow
from insdvl.studies.faults.stream import Sensors, stream_of
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner


def judged(row: FlightRow) -> dict[str, Any]:
    """Fly a row and judge it: its numbers, as JSON takes them.

    Velocity errors are RMS over time and seeds of the vector in body axes [m/s]: during the fault
    (if it is an instant: over the 5 s after it) and after it, each with the error of the flight
    without the fault at the same time.
    """
    pairs = [pair(row, seed) for seed in row.seeds]
    seen = row.judged_checks(pairs, always())
    recoveries = [p.recovery() for p in pairs]
    known = [time for time in recoveries if time is not None]
    end_ns = [max(p.end_ns, p.begin_ns + 5 * NS) for p in pairs]
    during = [(p.begin_ns, end) for p, end in zip(pairs, end_ns, strict=True)]
    after = [p.after_ns for p in pairs]
    return {
        "group": row.group,
        "fault": row.name,
        "seeds": len(row.seeds),
        "error_during": _rms(pairs, during, "flight"),
        "error_during_calm": _rms(pairs, during, "calm"),
        "error_after": _rms(pairs, after, "flight"),
        "error_after_calm": _rms(pairs, after, "calm"),
        "recovery": max(known) if len(known) == len(recoveries) else None,
        "lost": sum(p.flight.lost for p in pairs),
        "checks": seen,
        "met": all(check["met"] for check in seen),
    }


def judged_row(number: int) -> dict[str, Any]:
    """Fly and judge a row of `ROWS` by its number, which can be sent to another process."""
    return judged(ROWS[number])


def pair(row: FlightRow, seed: int) -> Pair:
    """Fly a seed of a row with the fault and without."""
    stream = stream_of(row.sensors, seed, row.duration)
    parameters = parameters_of(stream.mission, row.sensors, seed, row.parameters)
    faulted = row.change(stream, np.random.default_rng([seed, 3]))
    flight = fly(faulted, parameters, _tuner(row.sensors))
    shift_ns = 0
    if row.calm is not None:
        shift_ns = row.sensors.start_ns - row.calm.start_ns
    calm = _calm(row.calm or row.sensors, seed, row.duration, tuple(sorted(row.parameters.items())))
    begin_ns, end_ns = (
        stream.mission.start_ns + round(seconds * NS) for seconds in (row.begin, row.end)
    )
    if shift_ns:
        flight = replace(flight, times_ns=flight.times_ns - shift_ns)
        begin_ns, end_ns = begin_ns - shift_ns, end_ns - shift_ns
    return Pair(flight, calm, begin_ns, end_ns)


@lru_cache(maxsize=16)
def _calm(
    sensors: Sensors, seed: int, duration: float, parameters: tuple[tuple[str, Any], ...]
) -> Flight:
    stream = stream_of(sensors, seed, duration)
    filter_parameters = parameters_of(stream.mission, sensors, seed, dict(parameters))
    return fly(stream, filter_parameters, _tuner(sensors))


def _tuner(sensors: Sensors) -> Tuner | None:
    return Tuner(TunerParameters()) if sensors.learned else None


def _rms(pairs: Iterable[Pair], windows: Iterable[tuple[int, int]], which: str) -> float | None:
    errors = []
    for p, (begin_ns, end_ns) in zip(pairs, windows, strict=True):
        flight: Flight = getattr(p, which)
        errors.append(flight.error[flight.inside(begin_ns, end_ns)])
    error = np.concatenate(errors)
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) if error.size else None
