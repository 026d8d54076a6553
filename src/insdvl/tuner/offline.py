"""The output of a tuner for a whole recording at once, with any estimator.

The rules are those of `Tuner`: the stamps alone decide which sample closes a window, and no window
spans a gap.
"""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.tuner.own import HISTORY, WINDOW, OwnEstimator
from insdvl.tuner.windows import CHANNELS, period, rate_of

Indices = NDArray[np.intp]

_AT_ONCE = 64  # windows; a history of 2000 samples of six channels takes 96 kilobytes

#: Windows (M, N) of one channel each to the variances (M,) of their noise.
Estimator = Callable[[Array], Array]


def closing_samples(
    stamps_ns: Stamps, window: int, rate: float, max_gap_ns: int
) -> tuple[Indices, Indices]:
    """The samples at which a tuner makes an estimate.

    Args:
        stamps_ns: (N,) stamps of the samples, increasing.
        window: Number of samples of a window.
        rate: Rate of the tuner [Hz].
        max_gap_ns: A window that spans a longer interval between stamps is not used.

    Returns:
        (K,) indices, and the number of samples (K,) without a gap that end with each, >= `window`.

    Raises:
        ValueError: The stamps do not increase.
    """
    steps = np.diff(stamps_ns)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0))
        raise ValueError(f"stamps must increase, got {stamps_ns[k]} and then {stamps_ns[k + 1]}")
    # The product of a stamp and the numerator of the rate exceeds 64 bits.
    periods = period(stamps_ns.astype(object), Fraction(rate) / NS)
    opens = np.zeros(stamps_ns.size, bool)
    opens[1:] = periods[1:] != periods[:-1]
    beginning = np.zeros(stamps_ns.size, np.intp)  # first sample of the run without a gap
    after_gap = np.flatnonzero(steps > max_gap_ns) + 1
    beginning[after_gap] = after_gap
    filled = np.arange(1, stamps_ns.size + 1) - np.maximum.accumulate(beginning)
    closing = np.flatnonzero(opens & (filled >= window))
    return closing, filled[closing]


def tuned(
    stamps_ns: Stamps,
    samples: Array,
    estimate: Estimator,
    window: int,
    rate: float,
    max_gap_ns: int,
    history: int | None = None,
) -> tuple[Stamps, Array]:
    """The process noise that a tuner with this estimator publishes for a whole recording.

    Args:
        stamps_ns: (N,) increasing.
        samples: (N, 6) finite specific force [m/s^2] and angular rate [rad/s].
        estimate: The estimator, such as `Model.variances` or one of `closed_form`.
        window: Number of samples of a window.
        rate: Rate of the tuner [Hz].
        max_gap_ns: A window that spans a longer interval between stamps is not used.
        history: Largest number of samples for an estimator that uses as many as there are, up to
            this; None for one that always uses `window` samples.

    Returns:
        Stamps (K,) from which on the variances (K, 6) apply.

    Raises:
        ValueError: The stamps do not increase, or `estimate` rejects a window.
    """
    return at_windows(stamps_ns, samples, estimate, (), window, rate, max_gap_ns, history)


def at_windows(
    stamps_ns: Stamps,
    samples: Array,
    compute: Callable[[Array], Array],
    shape: tuple[int, ...],
    window: int,
    rate: float,
    max_gap_ns: int,
    history: int | None = None,
) -> tuple[Stamps, Array]:
    """Anything that is computed of the windows of a tuner; see `tuned` for the other arguments.

    Args:
        compute: Maps windows (M, N) of one channel each to arrays (M, *shape).
        shape: Of the result of one window.

    Returns:
        Stamps (K,) of the windows, and the results (K, 6, *shape).
    """
    closing, filled = closing_samples(stamps_ns, window, rate, max_gap_ns)
    results = np.empty((closing.size, CHANNELS, *shape))
    lengths = np.minimum(filled, history or window)
    for length in np.unique(lengths):
        of_length = np.flatnonzero(lengths == length)
        windows = sliding_window_view(samples, length, axis=0)
        for first in range(0, of_length.size, _AT_ONCE):
            some = of_length[first : first + _AT_ONCE]
            chosen = np.ascontiguousarray(windows[closing[some] - (length - 1)])
            results[some] = compute(chosen.reshape(-1, length)).reshape(-1, CHANNELS, *shape)
    return stamps_ns[closing], results


def tuned_by_own(
    stamps_ns: Stamps, samples: Array, own: OwnEstimator, rate: float, max_gap_ns: int
) -> tuple[Stamps, Array]:
    """The same with an estimator of your own; see `tuned`.

    Raises:
        EstimatorError: The estimator failed.
    """
    closing, filled = closing_samples(stamps_ns, WINDOW, rate, max_gap_ns)
    variances = np.empty((closing.size, CHANNELS))
    for row, last, count in zip(variances, closing, np.minimum(filled, HISTORY), strict=True):
        first = last - count + 1
        of_imu = rate_of(int(stamps_ns[first]), int(stamps_ns[last]), int(count))
        row[:] = own(samples[first : last + 1], of_imu)
    return stamps_ns[closing], variances
