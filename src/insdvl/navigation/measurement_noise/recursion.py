"""A factor on the covariance of a measurement's noise, by variational Bayes.

The noise n of a measurement has the covariance lambda R_0, and lambda an inverse-gamma
distribution. The innovation is nu = n + e, where e has the covariance M = H P H^T and what else is
known. Given lambda, n is normal; given n, lambda is inverse-gamma again. A few fixed iterations
between the two approach the joint posterior (Sarkka and Nummenmaa, IEEE Transactions on Automatic
Control 54(3), 2009, with one factor in place of one variance for each component).
"""

from math import exp
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array

#: Between lambda and the noise; more change the result by less than a thousandth.
ITERATIONS = 3
#: Weight of what is expected before anything was learned, as a shape: of 4/m measurements.
PRIOR = 2.0


class Belief(NamedTuple):
    """An inverse-gamma distribution of the factor.

    Attributes:
        shape: Half the number of components that it has learned from, the older ones for less.
        scale: Half the sum of their squares, in units of R_0.
    """

    shape: float
    scale: float

    @property
    def factor(self) -> float:
        """The factor whose inverse is the mean of 1 / lambda."""
        return self.scale / self.shape

    def limited(self, low: float, high: float) -> "Belief":
        """The same with a factor between two bounds."""
        return self._replace(scale=self.shape * min(max(self.factor, low), high))


class Whitened(NamedTuple):
    """An innovation in the axes in which R_0 is the identity and M is diagonal.

    Attributes:
        squares: (m,) of the innovation's components.
        known: (m,) variances of e.
    """

    squares: Array
    known: Array


def whitened(innovation: Array, M: Array, R_0: Array) -> Whitened | None:
    """An innovation (m,) of noise R_0 (m, m) and other error M (m, m).

    None where R_0 is not positive definite.
    """
    try:
        L_inv = np.linalg.inv(np.linalg.cholesky(R_0))
    except np.linalg.LinAlgError:
        return None
    known, axes = np.linalg.eigh(L_inv @ M @ L_inv.T)
    return Whitened(np.square(axes.T @ L_inv @ innovation), np.maximum(known, 0.0))


def evidence(innovation: Whitened, factor: float) -> float:
    """Expected sum of the squares of the noise n, in units of R_0, given the innovation.

    n has the mean lambda / (lambda + d) nu and the variance lambda d / (lambda + d) in each axis
    with the known variance d.
    """
    share = factor / (factor + innovation.known)
    return float(np.sum(share**2 * innovation.squares + share * innovation.known))


def forgotten(belief: Belief, seconds: float, memory: float, fewest: float) -> Belief:
    """What is left of a belief after a time [s].

    It forgets with the time constant ``memory`` [s], but no faster than to remember ``fewest``
    measurements.
    """
    rho = max(exp(-seconds / memory), 1.0 - 1.0 / fewest)
    return Belief(rho * belief.shape, rho * belief.scale)


def learned(belief: Belief, innovation: Whitened, low: float, high: float) -> Belief:
    """The belief after one more innovation, its factor between two bounds."""
    shape = belief.shape + len(innovation.squares) / 2.0
    factor = min(max(belief.factor, low), high)
    scale = belief.scale
    for _ in range(ITERATIONS):
        scale = belief.scale + evidence(innovation, factor) / 2.0
        factor = min(max(scale / shape, low), high)
    return Belief(shape, shape * factor)
