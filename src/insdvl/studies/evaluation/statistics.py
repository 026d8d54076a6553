"""Paired comparison of approaches over Monte Carlo runs, with bootstrap intervals.

All approaches see the same runs, so the bootstrap draws a run with all of its results. A ratio
keeps the pairs, and most of the difference between runs cancels.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array

Draws = NDArray[np.intp]

RESAMPLES = 10_000
LEVEL = 0.95

#: Middle, lower and upper end of an interval.
Interval = tuple[float, float, float]


def resamples(groups: NDArray[np.int64], rng: np.random.Generator) -> Draws:
    """Weights (RESAMPLES, R): how often each run is in each resample.

    Args:
        groups: (R,) number of the group of each run, from 0. Runs of one group depend on each
            other (the seeds of one recording), so groups are drawn whole.
        rng: Generator of the draws.
    """
    n_groups = int(groups.max()) + 1
    drawn = rng.integers(n_groups, size=(RESAMPLES, n_groups))
    counts = np.zeros((RESAMPLES, n_groups), dtype=np.intp)
    np.add.at(counts, (np.arange(RESAMPLES)[:, None], drawn), 1)
    return counts[:, groups]


def mean(a: Array, draws: Draws) -> Interval:
    """Mean of a (R,) over the runs and its 95 % interval."""
    return _interval(float(np.mean(a)), draws @ a / draws.sum(axis=1))


def ratio_of_means(a: Array, b: Array, draws: Draws) -> Interval:
    """Ratio of the means of a (R,) and b (R,) over the same runs, and its 95 % interval."""
    return _interval(float(np.mean(a) / np.mean(b)), (draws @ a) / (draws @ b))


def _interval(middle: float, resampled: Array) -> Interval:
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(resampled, [tail, 100.0 - tail])
    return middle, float(low), float(high)
