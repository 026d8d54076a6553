"""What a measurement says of itself; it is asked before anything is predicted.

A sensor that repeats an earlier reading has none: it lost its lock, its driver has stopped, or two
publishers send the same. But a sensor with a coarse resolution repeats itself by chance. The two
are told apart by the probability of the chance (docs/explanation/filter.md, "Repeats").
"""

import math
from math import comb, pi, sqrt
from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.events import Measurement
from insdvl.navigation.measurements.base import Past, SensorModel
from insdvl.navigation.state.fields import NEVER, State

#: A repetition that chance makes less often than this is none by chance.
LEAST_CHANCE = 1e-3
#: Steps in which DVLs report [m/s]; what is finer counts as the last.
RESOLUTIONS = (0.01, 1e-3, 1e-4, 1e-5, 1e-6)
#: From one reading to the next, so many that their scatter tells the noise.
_STEPS = 3
#: Rounding to single precision, relative; twice of it, for a scale that was applied there too.
_ROUNDING = 2.0**-23


def refusal(memory: State, model: SensorModel[Any], event: Measurement) -> str:
    """Why a measurement says by itself that it is none; empty, and it is remembered, if not.

    Args:
        memory: Of its kind, in the state record.
        model: Of its sensor.
        event: The measurement.
    """
    reading = np.array(model.reading(event))
    m, readings = len(reading), memory["readings"]
    known, equal, again = _compare(readings, reading)
    repeats = int(memory["repeats"]) + 1 if again else 0
    contradicted = int(memory["rejected_from_ns"]) != NEVER
    reason = model.refusal(event, Past(readings[:known, :m], equal, repeats, contradicted))
    if not reason:
        _remember(readings, reading)
    if again or not reason:
        memory["repeats"] = repeats
    return reason


@kernel
def _compare(readings: Array, reading: Array) -> tuple[int, int, bool]:
    """How many readings (k, m), the newest first, are known; how many equal this one; the newest.

    One that is not known, nan, equals none.
    """
    known, equal, again = 0, 0, False
    for k in range(len(readings)):
        others = 0
        for i in range(len(reading)):
            others += readings[k, i] != reading[i]
        known += math.isfinite(readings[k, 0])
        equal += others == 0
        again = again or (k == 0 and others == 0)
    return known, equal, again


@kernel
def _remember(readings: Array, reading: Array) -> None:
    """Put a reading before the others; the last one is forgotten."""
    for k in range(len(readings) - 1, 0, -1):
        readings[k] = readings[k - 1]
    for i in range(len(reading)):
        readings[0, i] = reading[i]


def is_frozen(past: Past, least: int) -> bool:
    """Whether a sensor repeats one number: so many times in a row, or after it was rejected.

    Args:
        past: What was read before.
        least: Number of equal readings; 0 for never.
    """
    again = past.contradicted and past.repeats > 0
    return least > 0 and (again or least <= past.repeats + 1)


def resolution(values: Array) -> float:
    """The largest of `RESOLUTIONS` of which all values are multiples, in single precision."""
    for step in RESOLUTIONS[:-1]:
        steps = values / step
        if (np.abs(steps - np.rint(steps)) <= _ROUNDING * np.abs(steps)).all():
            return step
    return RESOLUTIONS[-1]


def repeat_chance(reading: Array, readings: Array, sigma: Array) -> float:
    """Bound on the probability that a good reading repeats as many earlier ones as this one does.

    A reading of noise sigma that is rounded to steps r is in one step with probability at most
    p(x) r, with p its density. Then n given readings and this one are in one step with probability
    at most the integral of (p r)^n p, which is (r / (sqrt(2 pi) sigma))^n / sqrt(n + 1) for each
    component; and there are k over n choices of them. A vehicle that moves makes it less.

    Args:
        reading: (m,) of the measurement, the components that were measured.
        readings: (k, m) before it, the newest first.
        sigma: (m,) of its noise, as it is told. The noise is taken as no more than the scatter from
            one reading to the next.

    Returns:
        1 where it repeats none.
    """
    same = (readings == reading).all(axis=1)
    equal = int(np.count_nonzero(same))
    if equal == 0:
        return 1.0
    if len(readings) > _STEPS:
        run = equal if same.all() else int(np.argmin(same))
        steps = np.diff(readings[max(run - 1, 0) :], axis=0)  # without the repetitions in question
        if len(steps) < _STEPS:
            return 1.0
        sigma = np.minimum(sigma, np.sqrt(np.mean(steps**2, axis=0) / 2.0))
    step = resolution(np.vstack([readings, reading]))
    moving = sigma > 0.0
    within = (step / (sqrt(2.0 * pi) * sigma[moving])) ** equal / sqrt(equal + 1.0)
    return comb(len(readings), equal) * float(np.prod(np.minimum(within, 1.0)))
