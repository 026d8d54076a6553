"""Means of successive samples, for IMUs that are faster than those that a model has learned from.

A model of band powers has learned from samples at 100 Hz at which frequencies vehicles move and
vibrate. At 400 Hz its bands would be four times as high, and its history a quarter as long. So it
is given means of as many samples as make about 100 Hz. White noise of a variance q per sample has
q / k in a mean of k, so what the model finds is multiplied by k.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner.windows import Estimator

RATE = 100.0  # Hz, of the samples that models of band powers have learned from
MOST = 10  # samples in a mean


def pool_of(rate: float) -> int:
    """Number k of samples in a mean, for an IMU of a rate [Hz]."""
    return min(max(round(rate / RATE), 1), MOST)


def means(windows: Array, k: int) -> Array:
    """Means (M, N // k) of k successive samples each; the first N mod k samples are left out."""
    if k == 1:
        return windows
    M, N = windows.shape
    return np.ascontiguousarray(windows[:, N % k :].reshape(M, N // k, k).mean(axis=2))


def pooled(estimate: Estimator, k: int) -> Estimator:
    """An estimator of variances per sample, for windows of single samples, that sees means of k."""
    return lambda windows: k * estimate(means(windows, k))
