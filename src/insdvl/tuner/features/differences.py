"""Variance of differences of a high order, which separates white noise from fast motion.

The k-th difference of white noise of variance q has the variance C(2k, k) q. It suppresses motion
that is slow compared with the sampling: a sinusoid of angular frequency w per sample is multiplied
by (2 sin(w / 2))^k, so its share of the estimate falls with the k-th power of the squared
frequency. Turns of a vehicle and much of its vibration, which no polynomial follows over a whole
window and `closed_form.degree_5` takes for noise, are suppressed; sensor noise is not. The price is
precision: the differences are correlated with each other.

Behind a low-pass in the IMU all differences have less than the noise that a filter integrates. The
noise then falls towards half of the rate in all channels. So does vibration that all channels have
in common; bands of the spectrum tell the two apart.
"""

from math import comb

import numpy as np

from insdvl.arrays import Array
from insdvl.tuner.features.band_forms import least_band
from insdvl.tuner.features.bands import NEAR, WINDOW
from insdvl.tuner.features.detrend import checked
from insdvl.tuner.windows import Estimator, means, pool_of

#: Orders of differences that tell a low-pass: white noise has the same variance in both, and behind
#: a low-pass at 0.3 of the rate 0.4 of it in the higher one.
LOWER, HIGHER = 3, 6
_FALLS = 0.9

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

    The accelerometers tell it, which move less than the gyroscopes turn, by the least of the bands
    that no low-pass reaches. A low-pass is the same in all channels.

    Args:
        samples: (N, 6) specific force and angular rate.
    """
    channels = np.ascontiguousarray(samples.T)
    if len(samples) < WINDOW or not is_low_passed(
        difference_variances(channels, LOWER), difference_variances(channels, HIGHER)
    ):
        return 1.0
    force = channels[:3]
    shown = difference_variances(force, 1).mean()
    return max(float(_least_bands(force).mean() / shown), 1.0)


def integrated_variances(samples: Array, rate: float) -> tuple[float, float]:
    """Variances per sample of the noise that a filter integrates, of specific force and rate.

    Differences leave slow motion out, and bands the vibration: of the two the smaller one counts.
    The mean is over the axes.

    Args:
        samples: (N, 6) specific force and angular rate.
        rate: Of the IMU [Hz].
    """
    channels = np.ascontiguousarray(samples.T)
    differences = difference_variances(channels, 1) * low_pass_factor(samples)
    f, w = differences.reshape(2, 3).mean(axis=1).tolist()
    k = pool_of(rate)
    if len(samples) >= k * WINDOW:
        bands = k * _least_bands(means(channels, k)).reshape(2, 3).mean(axis=1)
        f, w = min(f, float(bands[0])), min(w, float(bands[1]))
    return f, w


def _least_bands(channels: Array) -> Array:
    """Mean `least_band` (M,) of channels (M, N), N >= `WINDOW`, over stretches of up to `NEAR`."""
    M, N = channels.shape
    n = min(N // WINDOW * WINDOW, NEAR)
    stretches = channels[:, : N // n * n].reshape(-1, n)
    return np.asarray(least_band(stretches).reshape(M, -1).mean(axis=1))


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
