"""Whose noise a measurement has: that of its message, or that of the parameters."""

import numpy as np

from insdvl.arrays import Array

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
    variance = np.diagonal(told)
    unknown = variance == 0.0
    if whose == "largest":
        raised = (variance > 0.0) & (variance < floor**2)
        factor = np.ones(len(variance))
        factor[raised] = floor / np.sqrt(variance[raised])
        told = factor[:, None] * told * factor
    return np.where(unknown[:, None] | unknown, own, told) if unknown.any() else told
