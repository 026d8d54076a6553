"""The last samples of an IMU without a gap, means of them, and the periods of the tuner.

A model of band powers has learned from samples at 100 Hz at which frequencies vehicles move and
vibrate. At 400 Hz its bands would be four times as high, and its history a quarter as long. So it
is given means of as many samples as make about 100 Hz. White noise of a variance q per sample has
q / k in a mean of k, so what the model finds is multiplied by k.
"""

from collections import deque
from collections.abc import Callable
from fractions import Fraction
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.navigation.events import NS

CHANNELS = 6  # specific force x, y, z, angular rate x, y, z
RATE = 100.0  # Hz, of the samples that models of band powers have learned from
MOST = 10  # samples in a mean

#: Windows (M, N) of one channel each to the variances per sample (M,) of their noise.
Estimator = Callable[[Array], Array]

_Stamp = TypeVar("_Stamp", int, NDArray[np.object_])


def period(stamp_ns: _Stamp, per_ns: Fraction) -> _Stamp:
    """Number of the period that a stamp lies in, counted from stamp 0.

    Args:
        stamp_ns: A Python integer or an array of them; the product exceeds 64 bits.
        per_ns: Periods per nanosecond, exactly.
    """
    return stamp_ns * per_ns.numerator // per_ns.denominator


class Window:
    """Ring of the last n <= N samples: the half-open interval (t - n dt, t] at the newest stamp t.

    Samples that are not finite, repeat the newest stamp or are older are dropped. An interval
    longer than `max_gap` empties the window; a shorter one (some lost samples) does not. A step
    back by more than `max_gap` is a restart (a recording that loops, a clock that was set) and not
    a late sample: it empties the window.

    Attributes:
        stamp_ns: Newest stamp; None before the first sample.
        filled: Number n of samples without a gap.
        counts: Samples used (``samples``) and dropped (``not_finite``, ``duplicates``,
            ``out_of_order``), and events that emptied the window (``gaps``, ``restarts``).
    """

    def __init__(self, size: int, max_gap_ns: int) -> None:
        """An empty window of at most `size` samples."""
        self.stamp_ns: int | None = None
        self.counts = {
            "samples": 0,
            "not_finite": 0,
            "duplicates": 0,
            "out_of_order": 0,
            "gaps": 0,
            "restarts": 0,
        }
        self._size = size
        self._max_gap_ns = max_gap_ns
        # Every sample is written twice, N apart: the last N are then always contiguous.
        self._ring = np.zeros((CHANNELS, 2 * size))
        self._stamps: deque[int] = deque(maxlen=size)
        self._next = 0
        self.filled = 0

    def add(self, stamp_ns: int, sample: Array) -> bool:
        """Add a sample (6,); False where it was dropped (see `counts`)."""
        if not np.isfinite(sample).all():
            self.counts["not_finite"] += 1
            return False
        if self.stamp_ns is not None:
            step = stamp_ns - self.stamp_ns
            if step == 0:
                self.counts["duplicates"] += 1
                return False
            if -self._max_gap_ns <= step < 0:
                self.counts["out_of_order"] += 1
                return False
            if step < 0:
                self.counts["restarts"] += 1
                self.filled = 0
            elif step > self._max_gap_ns:
                self.counts["gaps"] += 1
                self.filled = 0
        self.stamp_ns = stamp_ns
        self._stamps.append(stamp_ns)
        self.counts["samples"] += 1
        self._ring[:, self._next] = sample
        self._ring[:, self._next + self._size] = sample
        self._next = (self._next + 1) % self._size
        self.filled = min(self.filled + 1, self._size)
        return True

    def samples(self) -> Array:
        """The samples of each channel, oldest first, (6, filled)."""
        end = self._next + self._size
        return self._ring[:, end - self.filled : end]

    def rate(self, samples: int) -> float:
        """Rate [Hz] of the last 2 <= `samples` <= `filled`."""
        return rate_of(self._stamps[-samples], self._stamps[-1], samples)


def rate_of(first_ns: int, last_ns: int, samples: int) -> float:
    """Rate [Hz] of a number of samples > 1 with the first and the last of these stamps."""
    return (samples - 1) * NS / (last_ns - first_ns)


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
