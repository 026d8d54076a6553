"""Variance of differences of a high order, which separates white noise from fast motion.

The k-th difference of white noise of variance q has the variance C(2k, k) q. It suppresses motion
that is slow compared with the sampling: a sinusoid of angular frequency w per sample is multiplied
by (2 sin(w / 2))^k, so its share of the estimate falls with the k-th power of the squared
frequency. Turns of a vehicle and much of its vibration, which no polynomial follows over a whole
window and `closed_form.degree_5` takes for noise, are suppressed; sensor noise is not. The price is
precision: the differences are correlated with each other.
"""

from math import comb

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner.features.detrend import checked
from insdvl.tuner.windows import Estimator

#: Margin of the bound above the variance of differences, in relative errors of white noise.
SIGMAS = 3.0


def difference_variances(windows: Array, order: int) -> Array:
    """Unbiased variance (M,) of white noise in windows (M, N), from differences of an order < N.

    Raises:
        ValueError: `windows` has another shape, or a value is not within 1e70 of zero.
    """
    differences = np.diff(checked(windows, order + 1), n=order, axis=1)
    return np.mean(differences * differences, axis=1) / comb(2 * order, order)


def relative_error(n: int, order: int) -> float:
    """Relative standard deviation of `difference_variances` of Gaussian white noise.

    The relative variance of a mean of M correlated squares is 2 / M sum_j (1 - |j| / M) rho_j^2;
    differences of order k at a distance j have the correlation
    rho_j = (-1)^j C(2k, k + j) / C(2k, k).

    Args:
        n: Number of samples of a window, > order.
        order: k.
    """
    count = n - order
    total = 1.0
    for j in range(1, min(order, count - 1) + 1):
        rho = comb(2 * order, order + j) / comb(2 * order, order)
        total += 2.0 * (1.0 - j / count) * rho**2
    return float(np.sqrt(2.0 * total / count))


def bounded(estimate: Estimator, order: int, window: int) -> Estimator:
    """An estimator with the upper bound that differences of an order give.

    The bound is `SIGMAS` relative errors above their variance: it rarely acts in white noise, and
    takes over in motion.

    Args:
        estimate: The estimator.
        order: Order of the differences; 0 means no bound.
        window: Number of samples, the last ones of the estimator's, that the bound is from.
    """
    if order == 0:
        return estimate

    def bounded_estimate(windows: Array) -> Array:
        margin = 1.0 + SIGMAS * relative_error(window, order)
        bound = margin * difference_variances(windows[:, -window:], order)
        return np.minimum(estimate(windows), bound)

    return bounded_estimate
