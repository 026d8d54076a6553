"""How far an estimate from the innovations may be believed.

An innovation is noise of the sensor only as far as the filter's own error is what P says. With a Q
that is too small it is more, the estimate of R grows, the gain falls, and the innovations grow
further; with a Q that is too large the filter follows each ping, and none of its noise is seen. But
the innovations of a filter with the right gain are uncorrelated, whatever the noise is. With a gain
that is too small neighbours are alike, with one that is too large they alternate.
"""

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array

#: Innovations that the correlation is taken from.
MEMORY = 50
#: A component counts as no more than this many sigma.
LARGEST = 3.0
#: The correlation speaks against the gain from this many of its own sigma on, and surely from that.
DOUBT, SURE = 1.7, 3.4


class Correlation(NamedTuple):
    """Of neighbouring innovations.

    Attributes:
        product: Mean product of a component with that of the innovation before.
        square: Mean square of a component.
        pairs: Of innovations that have told it.
    """

    product: float
    square: float
    pairs: int


def normalised(innovation: Array, variances: Array) -> Array:
    """Components (m,) of an innovation in sigma, none beyond `LARGEST`."""
    return np.clip(innovation / np.sqrt(variances), -LARGEST, LARGEST)


def followed(told: Correlation, before: Array, now: Array) -> Correlation:
    """The correlation after one more pair of normalised innovations (m,)."""
    count = told.pairs + 1
    f = 1.0 / min(count, MEMORY)
    return Correlation(
        (1.0 - f) * told.product + f * float(np.mean(before * now)),
        (1.0 - f) * told.square + f * float(np.mean(now * now)),
        count,
    )


def doubt(told: Correlation, components: int) -> float:
    """How far the correlation speaks against the filter's gain, 0 to 1.

    The coefficient of N pairs of m independent components has a sigma of 1 / sqrt(m N), and an
    exponential mean of memory n is one of 2 n - 1 pairs.

    Args:
        told: The correlation.
        components: m, of an innovation.
    """
    if told.pairs == 0 or told.square <= 0.0:
        return 0.0
    pairs = min(told.pairs, 2 * MEMORY - 1)
    sigmas = abs(told.product) / told.square * sqrt(components * pairs)
    return min(max((sigmas - DOUBT) / (SURE - DOUBT), 0.0), 1.0)


def between(of_innovations: float, of_window: float, doubt: float) -> float:
    """The factor between two estimates, by the doubt about the first: a geometric mean."""
    return exp((1.0 - doubt) * log(of_innovations) + doubt * log(of_window))
