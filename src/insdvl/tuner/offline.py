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
from insdvl.tuner.features.differences import bounded
from insdvl.tuner.models import Model
from insdvl.tuner.own import HISTORY, WINDOW, OwnEstimator
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.windows import CHANNELS, Estimator, period, pool_of, pooled, rate_of

Indices = NDArray[np.intp]

_AT_ONCE = 64  # windows; 2000 samples of six channels take 96 kilobytes, at 1 kHz ten times that


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
    return at_windows(
        stamps_ns, samples, lambda x, _: estimate(x), (), window, rate, max_gap_ns, history
    )


def tuned_by_model(
    stamps_ns: Stamps, samples: Array, model: Model, parameters: TunerParameters
) -> tuple[Stamps, Array]:
    """The same with a model, as a tuner with these parameters uses it; see `tuned`."""
    order = parameters.difference_order
    return at_windows(
        stamps_ns,
        samples,
        lambda x, k: bounded(pooled(model.variances, k), order, model.window)(x),
        (),
        model.window,
        parameters.rate,
        round(parameters.max_gap * NS),
        model.history,
        model.schema.pooling,
    )


def at_windows(
    stamps_ns: Stamps,
    samples: Array,
    compute: Callable[[Array, int], Array],
    shape: tuple[int, ...],
    window: int,
    rate: float,
    max_gap_ns: int,
    history: int | None = None,
    pooling: bool = False,
) -> tuple[Stamps, Array]:
    """Anything that is computed of the windows of a tuner; see `tuned` for the other arguments.

    Args:
        compute: Maps windows (M, N) of one channel each, and the number of their samples in a mean,
            to arrays (M, *shape).
        shape: Of the result of one window.
        pooling: Whether `window` and `history` count means of samples, see windows.py.

    Returns:
        Stamps (K,) of the windows, and the results (K, 6, *shape).
    """
    closing, filled = closing_samples(stamps_ns, window, rate, max_gap_ns)
    pools = np.ones(closing.size, np.intp)
    if pooling:
        ends_ns = stamps_ns[closing]
        spans = zip(stamps_ns[closing - (window - 1)].tolist(), ends_ns.tolist(), strict=True)
        pools = np.array([pool_of(rate_of(*span, window)) for span in spans], np.intp)
        enough = filled >= window * pools
        closing, filled, pools = closing[enough], filled[enough], pools[enough]
    results = np.empty((closing.size, CHANNELS, *shape))
    lengths = np.minimum(filled, (history or window) * pools)
    for length, pool in np.unique(np.stack([lengths, pools], axis=1), axis=0).tolist():
        alike = np.flatnonzero((lengths == length) & (pools == pool))
        windows = sliding_window_view(samples, length, axis=0)
        for first in range(0, alike.size, _AT_ONCE):
            some = alike[first : first + _AT_ONCE]
            chosen = np.ascontiguousarray(windows[closing[some] - (length - 1)])
            found = compute(chosen.reshape(-1, length), pool)
            results[some] = found.reshape(-1, CHANNELS, *shape)
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
