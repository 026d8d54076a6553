"""Features of the schema `bands`: what the band powers of an IMU say of the noise of each channel.

All are logarithms of ratios of powers, so they do not depend on the unit. The scale is the least
of the bands of ``near`` that no IMU filters: the target is the logarithm of how far the density
that the filter needs is above it. Two more numbers tell how much of the history there is, and which
triad the channel is of.

What one channel cannot tell, the others of the IMU may: whether its slow bands are motion or
noise, and at what level the noise of such sensors is. So the features of a channel have the mean
spectra of the other two of its triad and of the other triad, each relative to its own least band,
and how far the channel's least band is above the others of its triad.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.bands import (
    FAST,
    HISTORY,
    SLOW,
    SMALLEST_RATIO,
    UNFILTERED,
    WINDOW,
    band_powers,
)
from insdvl.tuner.windows import CHANNELS

_QUANTILES = (0.1, 0.25, 0.5)  # of the frequencies of ``near``
_ORDERS = (0, 1, 2, 5, FAST + SLOW - 1)  # of the bands of ``near`` and ``slow``, ascending

#: Bands of a channel that the other channels are told.
TOLD = (*(f"near_{b}" for b in range(FAST)), *(f"slow_{b}" for b in range(SLOW)))
_OWN_NAMES = (
    *TOLD,
    *(f"now_{b}" for b in range(FAST)),
    "variance_now",
    "variance_near",
    *(f"quantile_{round(100 * level)}" for level in _QUANTILES),
    *(f"band_order_{order}" for order in _ORDERS),
    *(f"slope_{b}" for b in range(FAST + SLOW - 1)),
)
BAND_FEATURE_NAMES = (
    *_OWN_NAMES,
    *(f"triad_{name}" for name in TOLD),
    *(f"other_{name}" for name in TOLD),
    "above_triad",
    "gyroscope",
    "history",
)
_GREATEST = BAND_FEATURE_NAMES.index(f"band_order_{_ORDERS[-1]}")
_LEAST = BAND_FEATURE_NAMES.index(f"band_order_{_ORDERS[0]}")
_NOW = slice(BAND_FEATURE_NAMES.index("now_0"), BAND_FEATURE_NAMES.index(f"now_{FAST - 1}") + 1)


def band_features(windows: Array) -> tuple[Array, Array]:
    """Features (M, F) and scales (M,) of windows (M, N), N >= 200.

    Each six rows are the channels of an IMU at one time: specific force x, y, z, angular rate x, y,
    z. A window without noise has the scale 0.

    Raises:
        ValueError: `windows` has another shape, M is no multiple of six, or a value is not within
            1e70 of zero.
    """
    if len(windows) % CHANNELS:
        raise ValueError(
            f"windows must be those of whole IMUs, {CHANNELS} rows each, got {len(windows)} rows"
        )
    bands = band_powers(windows)
    X = np.zeros((len(windows), len(BAND_FEATURE_NAMES)))
    scale = np.empty(len(windows))
    quantiles = np.quantile(bands.spectrum, _QUANTILES, axis=1).T
    _band_features(
        np.hstack([bands.near, bands.slow, bands.now, bands.variance, quantiles]),
        np.array(_ORDERS),
        UNFILTERED,
        FAST,
        FAST + SLOW,
        X,
        scale,
    )
    _features_of_the_others(X, scale, len(_OWN_NAMES), len(TOLD))
    X[:, -1] = min(windows.shape[1], HISTORY) // WINDOW
    return X, scale


def band_bounds(X: Array) -> tuple[Array, Array]:
    """Lowest and highest output (M,) for features (M, F): the least and the greatest band.

    The bands are the closed forms that learning combines. Outside of its training a model is so
    never worse than the worst of them.
    """
    least = np.minimum(X[:, _LEAST], X[:, _NOW].min(axis=1))
    return least, np.maximum(X[:, _GREATEST], 0.0)


@kernel
def _band_features(
    powers: Array,
    orders: Array,
    unfiltered: int,
    fast: int,
    bands: int,
    X: Array,
    scale: Array,
) -> None:
    """The ratios of ``powers`` (M, P), their order and slopes into ``X``; ``scale`` (M,).

    The first ``fast`` powers are those of ``near``, of which the first ``unfiltered`` make the
    scale; the first ``bands`` are those with ``slow``.
    """
    M, P = powers.shape
    for m in range(M):
        scale[m] = powers[m, :unfiltered].min()
        if scale[m] <= 0.0:
            scale[m] = 0.0
            continue
        f = X[m]
        for p in range(P):
            f[p] = np.log(max(powers[m, p] / scale[m], SMALLEST_RATIO))
        ascending = np.sort(f[:bands])
        for k in range(orders.size):
            f[P + k] = ascending[orders[k]]
        at = P + orders.size
        for b in range(bands - fast - 1):  # the slow bands, then those of ``near``
            f[at + b] = f[fast + b] - f[fast + b + 1]
        at += bands - fast - 1
        f[at] = f[bands - 1] - f[0]
        for b in range(fast - 1):
            f[at + 1 + b] = f[b] - f[b + 1]


@kernel
def _features_of_the_others(X: Array, scale: Array, own: int, told: int) -> None:
    """What the other channels tell, into the columns of ``X`` (M, F) from ``own`` on.

    Channels without noise tell nothing. Where no other does, the channel is taken for one like
    them.
    """
    axes = CHANNELS // 2
    for m in range(X.shape[0]):
        triad = m // axes
        X[m, own + 2 * told + 1] = triad % 2
        if scale[m] == 0.0:
            continue
        for part in range(2):  # its triad, the other one
            first = (triad if part == 0 else triad + 1 - 2 * (triad % 2)) * axes
            at = own + part * told
            count, level = 0, 0.0
            for other in range(first, first + axes):
                if other != m and scale[other] > 0.0:
                    count += 1
                    level += np.log(scale[m] / scale[other])
                    for b in range(told):
                        X[m, at + b] += X[other, b]
            for b in range(told):
                X[m, at + b] = X[m, at + b] / count if count else X[m, b]
            if part == 0 and count:
                X[m, own + 2 * told] = level / count
