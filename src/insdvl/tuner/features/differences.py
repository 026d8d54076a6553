"""Variance of differences of a high order, which separates white noise from fast motion.

The k-th difference of white noise of variance q has the variance C(2k, k) q. It suppresses motion
that is slow compared with the sampling: a sinusoid of angular frequency w per sample is multiplied
by (2 sin(w / 2))^k, so its share of the estimate falls with the k-th power of the squared
frequency. Turns of a vehicle and much of its vibration, which no polynomial follows over a whole
window and `closed_form.degree_5` takes for noise, are suppressed; sensor noise is not. The price is
precision: the differences are correlated with each other.

Behind a low-pass in the IMU all differences have less than the noise that a filter integrates. A
low-pass is seen by the noise, which falls towards half of the rate in all channels alike, as
neither motion nor vibration does. Means of enough samples have the whole noise again.
"""

from math import comb

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner.features.detrend import checked
from insdvl.tuner.pooling import means
from insdvl.tuner.windows import Estimator

#: Orders of differences that tell a low-pass: white noise has the same variance in both, and behind
#: a low-pass at 0.3 of the rate 0.4 of it in the higher one.
LOWER, HIGHER = 3, 6
_FALLS = 0.9
#: Most samples in a mean that is white again, and by how much the density of white means may grow.
_LONGEST, _GROWS = 32, 1.3

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


def is_low_passed(lower: Array, higher: Array) -> bool:
    """Whether an IMU is low-passed, by variances (6,) of differences `LOWER` and `HIGHER`."""
    return bool((higher < _FALLS * lower).all())


def low_pass_factor(samples: Array) -> float:
    """Noise at low frequencies over that of first differences: 1 where there is no low-pass.

    The accelerometers tell it, which move less than the gyroscopes turn: by means of so many
    samples, a power of two, that the density of the noise grows no more with their number. A
    low-pass is the same in all channels.

    Args:
        samples: (N, 6) specific force and angular rate.
    """
    channels = np.ascontiguousarray(samples.T)
    if len(samples) < 2 * _LONGEST * HIGHER or not is_low_passed(
        difference_variances(channels, LOWER), difference_variances(channels, HIGHER)
    ):
        return 1.0
    force, m = channels[:3], 1
    density = _density(force, m)
    while m < _LONGEST:
        m, before = 2 * m, density
        density = _density(force, m)
        if density < _GROWS * before:
            break
    return max(float(density / difference_variances(force, 1).mean()), 1.0)


def _density(force: Array, m: int) -> float:
    """Mean over the axes (3, N) of m times the variance of the noise of means of m samples."""
    return float(m * difference_variances(means(force, m), LOWER).mean())


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
