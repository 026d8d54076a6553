"""Errors of all blocks of the state in a run, in units of what the filter says of them."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.coordinates import attitude_error, position_error, velocity_error
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.state import CORE
from insdvl.studies.consistency.flights import Flown
from insdvl.studies.evaluation.metrics import nees

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
#: Parts of the attitude, and all of the state with its correlations.
OTHERS: Mapping[str, slice] = MappingProxyType(
    {
        "heading": slice(ATTITUDE.start + 2, ATTITUDE.stop),
        "tilt": slice(ATTITUDE.start, ATTITUDE.start + 2),
        "all": slice(0, CORE),
    }
)
ALL: Mapping[str, slice] = MappingProxyType({**BLOCKS, **OTHERS})


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


def squared(run: Flown) -> dict[str, Array]:
    """NEES (K,) of each block, not divided by its degrees of freedom."""
    e, P = errors(run), run.filter.covariance(run.states)
    return {name: nees(e[:, at], P[:, at, at]) for name, at in ALL.items()}
