"""Closed-form estimators of the variance of white noise in a window, the rivals of learning.

Each maps windows (M, N) of one channel to variances (M,) in the square of its unit, depends neither
on the unit nor on a constant offset, and is unbiased where its model of the motion holds:

* `linear`: the motion is a straight line; N - 2 degrees of freedom;
* `first_differences`: the motion between two samples is negligible; the information of 2/3 N
  degrees of freedom, for many samples;
* `degree_5`: the motion is a polynomial of degree 5; N - 6 degrees of freedom.

The relative RMSE of nu degrees of freedom is sqrt(2 / nu): 10.2 % for `degree_5` and N = 200. No
unbiased estimator that allows for this motion is better, since the sum of squares of the residual
is a sufficient statistic for q.

`posterior_mean` also uses the knowledge that q is one of a few known values.
"""

import numpy as np
from scipy.special import gammaincinv, softmax

from insdvl.arrays import Array
from insdvl.tuner.features.detrend import residual_variances
from insdvl.tuner.features.differences import difference_variances

DEGREE = 5


def linear(windows: Array) -> Array:
    """Variance after linear detrend."""
    return residual_variances(windows, 1)


def first_differences(windows: Array) -> Array:
    """Half the mean square of first differences."""
    return difference_variances(windows, 1)


def degree_5(windows: Array) -> Array:
    """Variance around the least-squares polynomial of degree 5."""
    return residual_variances(windows, DEGREE)


def posterior_mean(windows: Array, grid: Array) -> Array:
    """Mean of q given the degree-5 residual, where q is one of `grid` (K,) with equal probability.

    It has the least mean square error of all estimators that see the residual only.
    """
    dof = np.shape(windows)[1] - DEGREE - 1
    return _posterior_mean(dof * degree_5(windows), grid, dof)


def _posterior_mean(squares: Array, grid: Array, dof: float) -> Array:
    """Mean of q (M,) given sums of squares (M,), which are q times a chi-square variable."""
    log_likelihood = -0.5 * dof * np.log(grid) - 0.5 * squares[:, None] / grid
    return softmax(log_likelihood, axis=1) @ grid


def bayes_rmse(grid: Array, dof: float, points: int = 4000) -> float:
    """The least possible RMSE on examples whose q is one of `grid` (K,), all equally frequent.

    Args:
        grid: The variances, which the estimator knows.
        dof: Degrees of freedom of the noise that it sees: N where the motion is known.
        points: Number of quantiles in the sum that approximates the integral.
    """
    # Of the chi-square distribution; scipy.stats has it too, but takes a second to import.
    quantiles = 2.0 * gammaincinv(dof / 2.0, (np.arange(points) + 0.5) / points)
    errors = [_posterior_mean(q * quantiles, grid, dof) - q for q in grid]
    return float(np.sqrt(np.mean(np.square(errors))))
