"""Features of the schema `taught`: the powers of a few groups of bands, as logarithms.

A power is the geometric mean of the bands of a group. All but the last feature are logarithms of
ratios to the least band of ``near``, so with these alone a window times any c gives an answer times
c^2. The last one is the logarithm of that scale itself: with it a model can know the level of the
vehicle that it was made for.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner.features.bands import FAST, SLOW, SMALLEST_RATIO, band_powers

_FROM_SINGLE = 2  # the first band above steering and waves, 3.25 Hz on at 100 Hz

#: Groups: bands of ``near``, or of ``slow``; frequencies at 100 Hz.
GROUPS = {
    "slow_0.1_0.4": ("slow", slice(0, 2)),
    "slow_0.4_1.6": ("slow", slice(2, SLOW)),
    "near_1_3.25": ("near", slice(0, _FROM_SINGLE)),
    "near_3.25_5.75": ("near", slice(_FROM_SINGLE, _FROM_SINGLE + 1)),
    "near_5.75_50": ("near", slice(_FROM_SINGLE + 1, FAST)),
}
GROUP_FEATURE_NAMES = (*GROUPS, "change", "level")


def group_features(windows: Array) -> tuple[Array, Array]:
    """Features (M, 7) and scales (M,) of windows (M, N), N >= 200, of one channel each.

    ``change`` is how far the last 2 s are above the last 6 s, from 3.25 Hz on. A window without
    noise has the scale 0, and zeros.

    Raises:
        ValueError: `windows` has another shape, or a value is not within 1e70 of zero.
    """
    bands = band_powers(windows)
    scale = bands.near.min(axis=1)
    scale[scale < 0.0] = 0.0
    noisy = scale > 0.0
    unit = np.where(noisy, scale, 1.0)[:, None]
    log = {
        name: np.log(np.maximum(getattr(bands, name) / unit, SMALLEST_RATIO))
        for name in ("now", "near", "slow")
    }
    X = np.empty((len(windows), len(GROUP_FEATURE_NAMES)))
    for k, (source, members) in enumerate(GROUPS.values()):
        X[:, k] = log[source][:, members].mean(axis=1)
    fast = slice(_FROM_SINGLE, FAST)
    X[:, len(GROUPS)] = (log["now"] - log["near"])[:, fast].mean(axis=1)
    X[:, -1] = np.log(unit[:, 0])
    X[~noisy] = 0.0
    return X, scale
