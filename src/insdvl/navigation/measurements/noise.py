"""Whose noise a measurement has: that of its message, or that of the parameters."""

import math

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel

#: Choices of a sensor's parameter ``covariance``.
CHOICES = ("largest", "message", "parameters")


def chosen(told: Array | None, own: Array, floor: float, whose: str) -> Array:
    """Covariance (m, m) of a measurement's noise.

    Args:
        told: (m, m) as the sender tells it, with zeros for a component of unknown variance; None
            where it tells nothing.
        own: (m, m) of the parameters, for what is unknown.
        floor: With ``largest``, the smallest sigma of a component that a message may tell.
        whose: One of `CHOICES`.
    """
    if told is None or whose == "parameters":
        return own
    R = np.empty(own.shape)
    _choose(R, np.array(told), own, floor if whose == "largest" else 0.0)
    return R


@kernel
def _choose(R: Array, told: Array, own: Array, floor: float) -> None:
    """R = what is told with at least the floor, and ``own`` where nothing is told."""
    for i in range(len(told)):
        for j in range(len(told)):
            if told[i, i] == 0.0 or told[j, j] == 0.0:
                R[i, j] = own[i, j]
            else:
                R[i, j] = _raised(told[i, i], floor) * told[i, j] * _raised(told[j, j], floor)


@kernel
def _raised(variance: float, floor: float) -> float:
    """Factor of a sigma that is below the floor."""
    return floor / math.sqrt(variance) if 0.0 < variance < floor * floor else 1.0
