"""The 24 published features of a window of one IMU channel.

Three transformations of the window, eight statistics of each:

* ``detrend``: the residual of the least-squares straight line;
* ``zscore``: (x - mean) / std;
* ``absolute``: |x|;

and min, max, median, std, mean, kurtosis, skewness and second-largest value. std has N - 1 in its
denominator, here and in the z-score. Skewness is m3 / m2^(3/2) and kurtosis m4 / m2^2 (Pearson:
3 for a Gaussian), with m_k the mean of the k-th power of the deviations.

Three features are constant by construction and have exactly that value: the mean of the residual
(0), and the mean (0) and the std (1) of the z-score. Their rounding noise has no information, and a
tree must not split on it.

A transformed window counts as constant where its std is at most 1e-14 of the window's largest |x|,
which is rounding noise, or below 1e-70. Its std, skewness and kurtosis are then 0, and so are all
z-scores of a constant window and the residual of a straight line. Values beyond 1e70 are rejected:
fourth powers stay in the range of a double. So every accepted window has finite features.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.detrend import HUGE, ROUNDING, TINY

TRANSFORMATIONS = ("detrend", "zscore", "absolute")
STATISTICS = ("min", "max", "median", "std", "mean", "kurtosis", "skewness", "second_largest")
FEATURE_NAMES = tuple(f"{t}_{s}" for t in TRANSFORMATIONS for s in STATISTICS)

#: Smallest number of samples of a window; with fewer every line fits.
MIN_SAMPLES = 3

_FEW = 8  # samples that are sorted
_HALVINGS = 60  # of an interval: enough to reach the rounding of a double without outliers


def features(windows: Array) -> Array:
    """The 24 features of each window, in the order of `FEATURE_NAMES`.

    Args:
        windows: (M, N) windows of one channel each, in stamp order.

    Returns:
        (M, 24).

    Raises:
        ValueError: `windows` is not (M, N) with N >= 3, or a value is not within 1e70 of zero.
    """
    windows = np.ascontiguousarray(windows, dtype=np.float64)
    if windows.ndim != 2 or windows.shape[1] < MIN_SAMPLES:
        raise ValueError(f"windows must be (M, N) with N >= {MIN_SAMPLES}, got {windows.shape}")
    out = np.empty((windows.shape[0], len(FEATURE_NAMES)))
    refused = _features(windows, out)
    if refused >= 0:
        values = windows[refused]
        wrong = values[~(np.abs(values) <= HUGE)][0]
        raise ValueError(f"window {refused} has {wrong}: values must be within {HUGE:g} of zero")
    return out


@kernel
def _count(x: Array, limit: float) -> int:
    """Number of elements of ``x`` up to ``limit``."""
    n = 0
    for i in range(x.size):
        n += x[i] <= limit
    return n


@kernel
def median(x: Array, smallest: float, largest: float, few: Array) -> float:
    """Median of ``x`` (N,) with known extremes.

    Halves the interval until it holds a few samples, and sorts those. Counting and gathering have
    no branches to mispredict, which would dominate the time of a full sort. Equal samples cannot be
    separated, hence the limit on the halvings. ``few`` (N,) is scratch.
    """
    N = x.size
    lower, upper = (N - 1) // 2, N // 2  # ranks of the middle, equal where N is odd
    low, high = smallest, largest
    below, inside = 0, N  # samples before the interval (low, high] and in it
    for _ in range(_HALVINGS):
        if inside <= _FEW:
            break
        middle = low + 0.5 * (high - low)
        n = _count(x, middle)
        if n <= lower:
            low, below, inside = middle, n, inside - (n - below)
        else:
            high, inside = middle, n - below
    if below == 0:
        low = -np.inf  # the smallest sample is inside as well
    n = 0
    for i in range(N):
        few[n] = x[i]
        n += low < x[i] <= high
    for i in range(1, n):
        value, j = few[i], i
        while j > 0 and few[j - 1] > value:
            few[j] = few[j - 1]
            j -= 1
        few[j] = value
    if upper - below < n:
        return 0.5 * few[lower - below] + 0.5 * few[upper - below]
    after = np.inf  # the upper one is the next sample after the interval
    for value in x:
        if high < value < after:
            after = value
    return 0.5 * few[lower - below] + 0.5 * after


@kernel
def _features(windows: Array, out: Array) -> int:
    """`features` of ``windows`` (M, N) into ``out`` (M, 24).

    Returns:
        The first window with a rejected value, at which the computation stops; else -1.
    """
    M, N = windows.shape
    middle = 0.5 * (N - 1)
    time_square = N * (N * N - 1.0) / 12.0  # sum of (i - middle)^2
    deviation = np.empty(N)
    residual = np.empty(N)
    magnitude = np.empty(N)
    few = np.empty(N)
    for m in range(M):
        x = windows[m]
        f = out[m]

        sum_x = 0.0
        sum_a = 0.0
        a_min = np.inf
        a_max = a_second = 0.0
        for i in range(N):
            a = abs(x[i])
            magnitude[i] = a
            sum_x += x[i]
            sum_a += a
            a_min = a if a < a_min else a_min
            runner_up = a if a < a_max else a_max
            a_second = runner_up if runner_up > a_second else a_second
            a_max = a if a > a_max else a_max
        if not (a_max <= HUGE and sum_a < np.inf):  # a NaN is in the sum only
            return m
        x_mean = sum_x / N
        a_mean = sum_a / N

        # The means above have the rounding of sums of large numbers; the deviations from them are
        # small, and their means correct it.
        sum_d = 0.0
        sum_td = 0.0
        sum_b = 0.0
        for i in range(N):
            d = x[i] - x_mean
            sum_d += d
            sum_td += (i - middle) * d
            sum_b += magnitude[i] - a_mean
        d_mean = sum_d / N
        b_mean = sum_b / N
        slope = sum_td / time_square

        r_2 = r_3 = r_4 = d_2 = d_3 = d_4 = b_2 = b_3 = b_4 = 0.0
        r_min = d_min = np.inf
        r_max = r_second = d_max = d_second = -np.inf
        for i in range(N):
            d = (x[i] - x_mean) - d_mean
            deviation[i] = d
            d2 = d * d
            d_2 += d2
            d_3 += d2 * d
            d_4 += d2 * d2
            d_min = d if d < d_min else d_min
            runner_up = d if d < d_max else d_max
            d_second = runner_up if runner_up > d_second else d_second
            d_max = d if d > d_max else d_max

            r = d - slope * (i - middle)
            residual[i] = r
            r2 = r * r
            r_2 += r2
            r_3 += r2 * r
            r_4 += r2 * r2
            r_min = r if r < r_min else r_min
            runner_up = r if r < r_max else r_max
            r_second = runner_up if runner_up > r_second else r_second
            r_max = r if r > r_max else r_max

            b = (magnitude[i] - a_mean) - b_mean
            b2 = b * b
            b_2 += b2
            b_3 += b2 * b
            b_4 += b2 * b2

        tolerance = max(ROUNDING * a_max, TINY)
        f[:] = 0.0
        r_std = np.sqrt(r_2 / (N - 1))
        if r_std > tolerance:
            f[0] = r_min
            f[1] = r_max
            f[2] = median(residual, r_min, r_max, few)
            f[3] = r_std
            f[5] = N * r_4 / (r_2 * r_2)
            f[6] = r_3 / (r_2 * np.sqrt(r_2 / N))
            f[7] = r_second

        d_std = np.sqrt(d_2 / (N - 1))
        if d_std > tolerance:
            f[8] = d_min / d_std
            f[9] = d_max / d_std
            f[10] = median(deviation, d_min, d_max, few) / d_std
            f[11] = 1.0
            f[13] = N * d_4 / (d_2 * d_2)
            f[14] = d_3 / (d_2 * np.sqrt(d_2 / N))
            f[15] = d_second / d_std

        f[16] = a_min
        f[17] = a_max
        f[18] = median(magnitude, a_min, a_max, few)
        f[20] = a_mean + b_mean
        f[23] = a_second
        b_std = np.sqrt(b_2 / (N - 1))
        if b_std > tolerance:
            f[19] = b_std
            f[21] = N * b_4 / (b_2 * b_2)
            f[22] = b_3 / (b_2 * np.sqrt(b_2 / N))
    return -1
