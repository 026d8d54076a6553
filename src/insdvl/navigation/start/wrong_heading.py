"""A heading that was unknown, was found, and is contradicted by the gyroscope: it is unknown again.

An unknown heading is found by the Earth's rotation. Where the estimate is nearly half a turn off,
the sine of its error is near zero and hides it, and the covariance may shrink around the wrong
heading. The gyroscope bias then has to cover up to twice the Earth's horizontal rate, and moves
further than what was learned of it allows. Derivation: docs/explanation/start.md.
"""

import math
from collections.abc import Iterable

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.events import NS
from insdvl.navigation.measurements.base import Block, Vehicle
from insdvl.navigation.start.automatic import UNKNOWN_HEADING
from insdvl.navigation.start.parameters import InitialParameters
from insdvl.navigation.state.fields import State

#: One sigma of the heading at the start from which on half a turn is possible (4 sigma) [rad].
DOUBTFUL = math.radians(45.0)
#: A component of the gyroscope bias that has moved by more than so many sigma contradicts the
#: heading: 5 sigma of a filter that is right, which it gets to once in 600,000 looks, times 1.5, by
#: which its noise may be told too small.
CONTRADICTED = 7.5
#: What was estimated along with the wrong heading starts again with so many times its sigma.
SIGMAS = 5.0
#: Least part of a bias' variance that measurements have taken away: less is rounding.
LEAST_LEARNED = 1e-9
#: What else was estimated along with the wrong heading: one sigma of it is larger by as much, and
#: the tilt is in doubt by this [rad].
TILT = math.radians(0.3)

_HEADING = ATTITUDE.stop - 1


def watch(s: State) -> None:
    """A state has started; note whether its heading may be half a turn off."""
    s["start"]["heading_watched"] = s["nav"]["P"][_HEADING, _HEADING] > DOUBTFUL**2


def trust(s: State) -> None:
    """A sensor has told the heading; it is in no doubt any more where the sensor knows it."""
    if s["nav"]["P"][_HEADING, _HEADING] < DOUBTFUL**2:
        s["start"]["heading_watched"] = 0


def is_contradicted(s: State, told_b_w: Array, variance: float, walk: float) -> bool:
    """Whether a heading was found, and the gyroscope bias has moved further than allowed.

    The variance of an estimate about what was told is the part of the variance that measurements
    have taken away. That is a small one where the process noise is large, and the bias itself may
    still be far below its own sigma then.

    Args:
        s: A state whose heading is watched.
        told_b_w: (3,) bias as it was told at the start [rad/s].
        variance: Of each component then [(rad/s)^2].
        walk: Density of its random walk [(rad/s)^2/s].
    """
    nav = s["nav"]
    if nav["P"][_HEADING, _HEADING] > DOUBTFUL**2:  # none was found yet
        return False
    seconds = (int(nav["time_ns"]) - int(nav["start_ns"])) / NS
    before = variance + walk * seconds
    learned = before - np.diagonal(nav["P"])[GYROSCOPE_BIAS]
    moved = np.square(nav["b_w"] - told_b_w) > CONTRADICTED**2 * learned
    return bool(np.any(moved & (learned > LEAST_LEARNED * before)))


def restart(
    s: State, vehicle: Vehicle, initial: InitialParameters, told: Array, blocks: Iterable[Block]
) -> None:
    """The heading is unknown again, and the biases are those of the start.

    Velocity, tilt and position stay, without correlations and with `SIGMAS` times their sigma: they
    were estimated with the wrong heading. The path turns with the heading when that is found.

    Args:
        s: The state.
        vehicle: That has it.
        initial: Of the state.
        told: (6,) biases as they were told at the start, f, then w, base_link axes.
        blocks: Optional error states that are in use; they restart as well.
    """
    nav, n = s["nav"], vehicle.n
    before, P = nav["P"][:n, :n], np.zeros((n, n))
    for at in (VELOCITY, ATTITUDE, POSITION):
        P[at, at] = SIGMAS**2 * before[at, at]
    P[_HEADING, :] = P[:, _HEADING] = 0.0
    P[_HEADING, _HEADING] = UNKNOWN_HEADING**2
    tilt = np.arange(ATTITUDE.start, _HEADING)
    P[tilt, tilt] += TILT**2
    P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = np.eye(3) * initial.accelerometer_bias_std**2
    P[GYROSCOPE_BIAS, GYROSCOPE_BIAS] = np.eye(3) * initial.gyroscope_bias_std**2
    nav["optional"] = 0.0
    for block in blocks:
        at = vehicle.blocks[block.name]
        P[at, at] = np.diag(np.square(block.std))
        if block.initial:
            nav["optional"][vehicle.optional(block.name)] = block.initial
    nav["P"][:n, :n] = P
    nav["b_f"], nav["b_w"] = told[:3], told[3:]
    nav["start_ns"] = nav["time_ns"]  # what is unknown of the Earth's rotation begins anew
    s["start"]["heading_watched"] = 0
    s["counters"]["wrong_headings"] += 1
