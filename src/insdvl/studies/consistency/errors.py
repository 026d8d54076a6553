"""Errors of all blocks of the state in a run, in units of what the filter says of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import chdtri

from insdvl.arrays import Array, Records
from insdvl.navigation.coordinates import attitude_error, position_error, velocity_error
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.filter import Filter
from insdvl.navigation.state.fields import CORE
from insdvl.simulation.motion import Truth
from insdvl.studies.evaluation import metrics

#: Blocks of the error state.
BLOCKS: Mapping[str, slice] = MappingProxyType(
    {
        "velocity": VELOCITY,
        "attitude": ATTITUDE,
        "accelerometer bias": ACCELEROMETER_BIAS,
        "gyroscope bias": GYROSCOPE_BIAS,
        "position": POSITION,
    }
)
#: Parts of the attitude, and several blocks with their correlations.
OTHERS: Mapping[str, slice] = MappingProxyType(
    {
        "heading": slice(ATTITUDE.start + 2, ATTITUDE.stop),
        "tilt": slice(ATTITUDE.start, ATTITUDE.start + 2),
        "biases": slice(ACCELEROMETER_BIAS.start, GYROSCOPE_BIAS.stop),
        "all": slice(0, CORE),
    }
)
ALL: Mapping[str, slice] = MappingProxyType({**BLOCKS, **OTHERS})

_HEADING = ALL["heading"].start


@dataclass(frozen=True)
class Flown:
    """Filter and truth at times (K,) of one run.

    Attributes:
        filter: The filter.
        states: (K,) its states.
        truth: The truth at their stamps.
        bias: (K, 6) true biases, f, then w.
    """

    filter: Filter
    states: Records
    truth: Truth
    bias: Array


def degrees_of_freedom(block: str) -> int:
    """Number of error states in a block."""
    at = ALL[block]
    return int(at.stop - at.start)


def errors(run: Flown) -> Array:
    """Exact error (K, 15) in the coordinates of the model: what `inject` would have to add."""
    nav, truth, invariant = run.states["nav"], run.truth, run.filter.vehicle.invariant
    C_n_b = truth.C_n_b
    out = np.empty((len(nav), CORE))
    out[:, VELOCITY] = velocity_error(nav, C_n_b, truth.v_n, invariant=invariant)
    out[:, ATTITUDE] = attitude_error(nav, C_n_b, invariant=invariant)
    out[:, ACCELEROMETER_BIAS] = run.bias[:, :3] - nav["b_f"]
    out[:, GYROSCOPE_BIAS] = run.bias[:, 3:] - nav["b_w"]
    out[:, POSITION] = position_error(nav, C_n_b, truth.llh, invariant=invariant)
    return out


def nees(run: Flown) -> dict[str, Array]:
    """NEES (K,) of each block, per degree of freedom."""
    e, P = errors(run), run.filter.covariance(run.states)
    return {
        name: metrics.nees(e[:, at], P[:, at, at]) / degrees_of_freedom(name)
        for name, at in ALL.items()
    }


def heading_deg(run: Flown) -> Array:
    """Error (K,) of the heading, within +-180."""
    return np.asarray(np.degrees(errors(run)[:, _HEADING]))


def heading_sigma_deg(run: Flown) -> Array:
    """What the filter says of it (K,), one sigma."""
    return np.asarray(np.degrees(np.sqrt(run.states["nav"]["P"][:, _HEADING, _HEADING])))


def band(block: str, runs: int, probability: float = 0.997) -> tuple[float, float]:
    """Where the mean NEES per degree of freedom of a consistent filter is, with a probability.

    It is that of one instant, or of errors which stay as they are throughout a run; of others the
    mean over time is nearer to 1.
    """
    dof = degrees_of_freedom(block) * runs
    low, high = chdtri(dof, [(1.0 + probability) / 2.0, (1.0 - probability) / 2.0]) / dof
    return float(low), float(high)
