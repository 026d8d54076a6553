"""Features of a window that depend neither on its unit nor on smooth motion of the vehicle.

They describe the residual r around the least-squares polynomial of degree 5, whose variance
s^2 = r'r / (N - 6) is the scale of the target log(q / s^2):

* the statistics of `handcrafted.features` for r / std and |r| / std, with std^2 = r'r / (N - 1),
  without mean and std of the first, which are 0 and 1;
* the logarithms of the variances from first to third differences of r, divided by s^2.

So a window times any factor has the same features, and the same bits where the factor is a power of
two. A constant offset such as gravity changes nothing beyond the rounding of the samples. A window
that is a polynomial of degree 5 to within rounding, such as a constant one, has no noise: its
features and its scale are 0, and so is q.

The residual is better than the window itself: training covers one range of variances, and for
another range a feature that depends on the motion leaves its range of the training, although the
noise looks the same. Cross-validation over the training trajectories, each unseen once (12 trees,
at least 200 examples per leaf, half of the data set), gave these relative RMSE for variances in
[0.001, 0.05], 1000 times smaller, and 10 times larger:

* these features: 10.3, 10.3, 10.4 %, with a bias of 0.6 to 0.7 %;
* the 24 features of the window divided by its spread, its linear variance and the differences of
  the window: 10.3, 10.8, 10.3 %, with a bias of 2.4 % for the smaller variances;
* the same with a target relative to the variance around a straight line: 10.2, 72, 10.3 %. Motion
  then dominates the scale, and trees do not extrapolate;
* s^2 itself: 10.2, 10.2, 10.3 %.

With at least 8, 50, 200 and 1000 examples per leaf it is 10.6, 10.4, 10.3 and 10.3 % within the
range. The limit of unbiased estimators is 10.2 %.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.tuner.features.closed_form import DEGREE
from insdvl.tuner.features.detrend import ROUNDING, checked, polynomials, residual
from insdvl.tuner.features.handcrafted import median

RESIDUAL_FEATURE_NAMES = (
    *(f"residual_{s}" for s in ("min", "max", "median", "kurtosis", "skewness", "second_largest")),
    "absolute_min",
    "absolute_max",
    "absolute_median",
    "absolute_std",
    "absolute_mean",
    "absolute_kurtosis",
    "absolute_skewness",
    "absolute_second_largest",
    "log_first_differences",
    "log_second_differences",
    "log_third_differences",
)

#: Smallest number of samples of a window: two more than the polynomial could pass through.
MIN_RESIDUAL_SAMPLES = DEGREE + 3

_SMALLEST_RATIO = 1e-30  # of variances, so that the logarithm of zero differences is defined


def residual_features(windows: Array) -> tuple[Array, Array]:
    """The features of each window, in the order of `RESIDUAL_FEATURE_NAMES`, and its scale.

    Args:
        windows: (M, N) windows of one channel each, in stamp order.

    Returns:
        (M, 17), and s^2 (M,) in the square of the window's unit.

    Raises:
        ValueError: `windows` is not (M, N) with N >= 8, or a value is not within 1e70 of zero.
    """
    windows = checked(windows, MIN_RESIDUAL_SAMPLES)
    X = np.empty((windows.shape[0], len(RESIDUAL_FEATURE_NAMES)))
    scale = np.empty(windows.shape[0])
    _residual_features(windows, polynomials(windows.shape[1], DEGREE), X, scale)
    return X, scale


@kernel
def _mean_square_differences(d: Array, n: int) -> float:
    """Replace ``d`` [:n] by its differences, and return their mean square."""
    squares = 0.0
    for i in range(n - 1):
        d[i] = d[i + 1] - d[i]
        squares += d[i] * d[i]
    return squares / (n - 1)


@kernel
def _residual_features(windows: Array, basis: Array, X: Array, scale: Array) -> None:
    """`residual_features` of ``windows`` (M, N) into ``X`` (M, 17) and ``scale`` (M,)."""
    M, N = windows.shape
    r = np.empty(N)
    a = np.empty(N)
    few = np.empty(N)
    for m in range(M):
        f = X[m]
        f[:] = 0.0
        squares = residual(windows[m], basis, r)
        scale[m] = squares / (N - 1 - basis.shape[0])
        if squares == 0.0:
            continue
        std = np.sqrt(squares / (N - 1))

        r_3 = r_4 = sum_a = 0.0
        r_min = a_min = np.inf
        r_max = r_second = -np.inf
        a_max = a_second = 0.0
        for i in range(N):
            u = r[i] / std
            r[i] = u
            u2 = u * u
            r_3 += u2 * u
            r_4 += u2 * u2
            r_min = u if u < r_min else r_min
            runner_up = u if u < r_max else r_max
            r_second = runner_up if runner_up > r_second else r_second
            r_max = u if u > r_max else r_max
            v = abs(u)
            a[i] = v
            sum_a += v
            a_min = v if v < a_min else a_min
            runner_up = v if v < a_max else a_max
            a_second = runner_up if runner_up > a_second else a_second
            a_max = v if v > a_max else a_max
        a_mean = sum_a / N
        a_2 = a_3 = a_4 = 0.0
        for i in range(N):
            d = a[i] - a_mean
            d2 = d * d
            a_2 += d2
            a_3 += d2 * d
            a_4 += d2 * d2

        m_2 = (N - 1.0) / N  # mean square of r / std
        f[0] = r_min
        f[1] = r_max
        f[2] = median(r, r_min, r_max, few)
        f[3] = r_4 / N / (m_2 * m_2)
        f[4] = r_3 / N / (m_2 * np.sqrt(m_2))
        f[5] = r_second
        f[6] = a_min
        f[7] = a_max
        f[8] = median(a, a_min, a_max, few)
        a_std = np.sqrt(a_2 / (N - 1))
        f[10] = a_mean
        f[13] = a_second
        if a_std > ROUNDING:
            f[9] = a_std
            f[11] = N * a_4 / (a_2 * a_2)
            f[12] = a_3 / (a_2 * np.sqrt(a_2 / N))

        relative = (N - 1.0 - basis.shape[0]) / (N - 1.0)  # std^2 over the scale
        f[14] = np.log(max(relative * _mean_square_differences(r, N) / 2.0, _SMALLEST_RATIO))
        f[15] = np.log(max(relative * _mean_square_differences(r, N - 1) / 6.0, _SMALLEST_RATIO))
        f[16] = np.log(max(relative * _mean_square_differences(r, N - 2) / 20.0, _SMALLEST_RATIO))
