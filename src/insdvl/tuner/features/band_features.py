"""Features of the schema `bands`: what the band powers of a channel say of its noise.

All are logarithms of ratios of powers, so they do not depend on the unit. The scale is the least
band of ``near``: the target is the logarithm of how far the density that the filter needs is above
it. One more number tells how much of the history there is.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.bands import FAST_EDGES, HISTORY, SLOW_EDGES, WINDOW, band_powers

_FAST, _SLOW = len(FAST_EDGES) - 1, len(SLOW_EDGES) - 1
_QUANTILES = (0.1, 0.25, 0.5)  # of the frequencies of ``near``
_ORDERS = (0, 1, 2, 5, _FAST + _SLOW - 1)  # of the bands of ``near`` and ``slow``, ascending

BAND_FEATURE_NAMES = (
    *(f"near_{b}" for b in range(_FAST)),
    *(f"slow_{b}" for b in range(_SLOW)),
    *(f"now_{b}" for b in range(_FAST)),
    "variance_now",
    "variance_near",
    *(f"quantile_{round(100 * level)}" for level in _QUANTILES),
    *(f"band_order_{order}" for order in _ORDERS),
    *(f"slope_{b}" for b in range(_FAST + _SLOW - 1)),
    "history",
)
_GREATEST = BAND_FEATURE_NAMES.index(f"band_order_{_ORDERS[-1]}")
_SMALLEST_RATIO = 1e-12  # keeps the logarithm of an empty band finite


def band_features(windows: Array) -> tuple[Array, Array]:
    """Features (M, F) and scales (M,) of windows (M, N), N >= 200, of one channel each.

    A window without noise has the scale 0.

    Raises:
        ValueError: `windows` has another shape, or a value is not within 1e70 of zero.
    """
    bands = band_powers(windows)
    X = np.zeros((len(windows), len(BAND_FEATURE_NAMES)))
    scale = np.empty(len(windows))
    quantiles = np.quantile(bands.spectrum, _QUANTILES, axis=1).T
    _band_features(
        np.hstack([bands.near, bands.slow, bands.now, bands.variance, quantiles]),
        np.array(_ORDERS),
        _FAST,
        _FAST + _SLOW,
        X,
        scale,
    )
    X[:, -1] = min(windows.shape[1], HISTORY) // WINDOW
    return X, scale


def band_bounds(X: Array) -> tuple[Array, Array]:
    """Lowest and highest output (M,) for features (M, F): the least band, the greatest band.

    The bands are the closed forms that learning combines. Outside of its training a model is so
    never worse than the worst of them.
    """
    return np.zeros(len(X)), np.maximum(X[:, _GREATEST], 0.0)


@kernel
def _band_features(
    powers: Array, orders: Array, fast: int, bands: int, X: Array, scale: Array
) -> None:
    """The ratios of ``powers`` (M, P), their order and slopes into ``X``; ``scale`` (M,).

    The first ``fast`` powers are those of ``near``, the first ``bands`` with those of ``slow``.
    """
    M, P = powers.shape
    for m in range(M):
        scale[m] = powers[m, :fast].min()
        if scale[m] <= 0.0:
            scale[m] = 0.0
            continue
        f = X[m]
        for p in range(P):
            f[p] = np.log(max(powers[m, p] / scale[m], _SMALLEST_RATIO))
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
