"""Pings that their neighbours contradict: those of a DVL that now and then hits something else.

The velocity in the axes of a window's start, less the integral of the specific force, is a straight
line in time by gravity, and what errors of mounts and biases add is smooth. So a ping should be
near the straight lines through any two of its neighbours, and the median of these lines is hardly
moved by another outlier among them.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array

#: Neighbours on either side through which the lines are drawn.
NEAR = 3
#: Sigmas from which on a ping is an outlier: noise alone has one in a million there.
OUTLIER = 5.0
#: Median of the size of a normal variable, in its sigma.
MEDIAN = 0.6745


def outliers(lines: Sequence[tuple[Array, Array]], smallest: float) -> list[NDArray[np.bool_]]:
    """Which pings of some windows are outliers, (K,) of each window.

    Args:
        lines: Of each window times (K,) [s] and velocities less the integral of force (K, 3) [m/s].
        smallest: Sigma that the departures have at least [m/s].
    """
    departures = [_departures(t, y) for t, y in lines]
    # Near the ends of a window the lines go on beyond their points and tell less.
    from_ends = [_from_ends(len(t)) for t, _ in lines]
    every, rank = np.concatenate(departures), np.concatenate(from_ends)
    sigma = np.full((NEAR + 1, 3), smallest)
    for k in range(NEAR + 1):
        found = every[rank == k]
        sigma[k] = np.maximum(np.median(np.abs(found), axis=0) / MEDIAN, smallest)
    return [
        (np.abs(e) > OUTLIER * sigma[k]).any(axis=1)
        for e, k in zip(departures, from_ends, strict=True)
    ]


def _from_ends(count: int) -> Array:
    """How many pings there are before, or behind, each one (K,); at most `NEAR`."""
    k = np.arange(count)
    return np.minimum(np.minimum(k, k[::-1]), NEAR)


def _departures(t: Array, y: Array) -> Array:
    """What each velocity is off the median of the lines through two neighbours, each (K, 3)."""
    steps = [step for step in range(-NEAR, NEAR + 1) if step]
    off = [_off_line(t, y, i, j) for i, j in combinations(steps, 2)]
    return np.asarray(np.nanmedian(off, axis=0))


def _off_line(t: Array, y: Array, i: int, j: int) -> Array:
    """What each velocity is off the line through its i-th and j-th neighbour (K, 3); else nan."""
    at = np.arange(len(t))
    at = at[(at + i >= 0) & (at + j < len(t))]
    share = ((t[at] - t[at + i]) / (t[at + j] - t[at + i]))[:, None]
    off = np.full(y.shape, np.nan)
    off[at] = y[at] - (1.0 - share) * y[at + i] - share * y[at + j]
    return off
