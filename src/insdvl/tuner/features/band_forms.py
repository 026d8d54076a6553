"""Closed-form estimators of the density that a filter needs, from the band powers of a channel.

Each maps windows (M, N) of one channel, 200 <= N <= 600, to variances per sample (M,) of white
noise, and is unbiased for white noise. They differ in what they take for motion:

* `single_band`: all but 3.25 to 5.75 Hz (at 100 Hz), between steering and vibration;
* `least_band`: all but the band with the least power, of those that no IMU filters;
* `median_of_spectrum`: less than half of the frequencies.

The factors follow from the distribution of the powers of white noise; nothing is fitted.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc, gammaincinv

from insdvl.arrays import Array
from insdvl.tuner.features.bands import NEAR, UNFILTERED, WINDOW, band_powers, transform

#: Number of the band of `single_band`.
SINGLE = 2


class Degrees(NamedTuple):
    """Degrees of freedom of powers of white noise: 2 mean^2 / variance.

    Attributes:
        bands: (7,) of the bands of ``near``.
        frequencies: (B,) of its frequencies.
    """

    bands: Array
    frequencies: Array


def single_band(windows: Array) -> Array:
    """Power of the band from 3.25 to 5.75 Hz (at 100 Hz)."""
    return band_powers(windows).near[:, SINGLE].copy()


def least_band(windows: Array) -> Array:
    """Least power of the unfiltered bands, divided by its mean for white noise of variance 1."""
    least = band_powers(windows).near[:, :UNFILTERED].min(axis=1)
    return least / mean_of_least(_used(windows))


def median_of_spectrum(windows: Array) -> Array:
    """Median power of the frequencies, divided by its median for white noise of variance 1."""
    return np.median(band_powers(windows).spectrum, axis=1) / median_of_white(_used(windows))


def _used(windows: Array) -> int:
    return min(windows.shape[1] // WINDOW * WINDOW, NEAR)


@cache
def degrees(n: int) -> Degrees:
    """Degrees of freedom of ``near`` for n samples.

    A power is x^T A x; for white noise x of variance 1 its mean is tr A and its variance 2 tr A^2.
    tr A^2 is the sum of the squared products of all pairs of rows that make A.
    """
    one = transform(WINDOW)
    half = WINDOW // 2
    count = one.norms.size
    parts = (n - WINDOW) // half + 1
    # Products of the rows of a part with those of the parts d halves later; those of d = 2 do not
    # overlap.
    overlaps = [one.rows[d * half :].T @ one.rows[: WINDOW - d * half] for d in range(2)]

    def of(chosen: NDArray[np.intp]) -> float:
        both = np.concatenate([chosen, chosen + count])
        squares = [float(np.sum(overlap[np.ix_(both, both)] ** 2)) for overlap in overlaps]
        mean = parts * float(np.sum(one.norms[chosen]))
        return mean**2 / (parts * squares[0] + 2.0 * (parts - 1) * squares[1])

    return Degrees(
        np.array([of(np.flatnonzero(one.band == b)) for b in range(one.bands)]),
        np.array([of(np.array([k])) for k in range(count)]),
    )


@cache
def mean_of_least(n: int) -> float:
    """Mean of the least of independent chi-square variables, each divided by its degrees."""
    x = (np.arange(4000) + 0.5) / 1000.0
    halves = degrees(n).bands[:UNFILTERED, None] / 2.0
    above = gammaincc(halves, halves * x)
    return float(np.sum(np.prod(above, axis=0)) / 1000.0)


@cache
def median_of_white(n: int) -> float:
    """Median of a chi-square variable divided by its degrees, those of the middle frequency."""
    dof = float(np.median(degrees(n).frequencies))
    return float(gammaincinv(dof / 2.0, 0.5) * 2.0 / dof)
