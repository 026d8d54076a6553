"""The spectrum of the error of one channel, and what variance it causes behind a linear filter.

Densities are two-sided: a white error of variance q in samples at an interval dt has q dt.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, expm1, pi

import numpy as np

#: Coefficients of a polynomial in s, the highest power first.
Polynomial = Sequence[float]


@dataclass(frozen=True)
class Spectrum:
    """A sum of independent stationary errors.

    Attributes:
        white: Density [unit^2/Hz].
        first_order: Variance [unit^2] and time constant [s] of each first-order (Gauss-Markov)
            error.
        lines: Variance [unit^2] and frequency [Hz] of each sine of random phase.
        bounded: Variance of an error of the integral that is independent from sample to sample,
            such as that of counts [(unit s)^2].
    """

    white: float = 0.0
    first_order: tuple[tuple[float, float], ...] = ()
    lines: tuple[tuple[float, float], ...] = ()
    bounded: float = 0.0

    def variance_behind(self, numerator: Polynomial, denominator: Polynomial) -> float:
        """Variance of the output of a stable linear filter whose input is this error.

        Args:
            numerator: Of the transfer function; its degree is one below the denominator's.
            denominator: Of degree 1 or 2.
        """
        total: float = self.white * energy(numerator, denominator)
        for variance, tau in self.first_order:
            pairs = zip((*denominator, 0.0), (0.0, *denominator), strict=True)
            longer = [a + b / tau for a, b in pairs]  # times s + 1 / tau
            total += 2.0 * variance / tau * energy(numerator, longer)
        for variance, frequency in self.lines:
            s = 2j * pi * frequency
            total += (
                variance * float(abs(np.polyval(numerator, s) / np.polyval(denominator, s))) ** 2
            )
        # Behind the differentiator that makes it, such an error passes as it is.
        return total + self.bounded * (numerator[0] / denominator[0]) ** 2

    def mean_density(self, duration: float) -> float:
        """Variance of the integral over a time [s], divided by this time [unit^2/Hz]."""
        total = self.white + 2.0 * self.bounded / duration
        for variance, tau in self.first_order:
            x = duration / tau
            total += 2.0 * variance * tau * (1.0 + expm1(-x) / x)
        for variance, frequency in self.lines:
            omega = 2.0 * pi * frequency
            total += 2.0 * variance * (1.0 - cos(omega * duration)) / (omega**2 * duration)
        return total


def flicker(coefficient: float, shortest: float, longest: float) -> tuple[tuple[float, float], ...]:
    """First-order errors, one per decade, whose sum has the density coefficient / |f|.

    The sum is within 6 % of it for frequencies from 1 / (2 pi longest) to 1 / (2 pi shortest),
    apart from the outer decade at each end.

    Args:
        coefficient: [unit^2].
        shortest: Smallest time constant [s].
        longest: Largest time constant [s].
    """
    count = round(np.log10(longest / shortest)) + 1
    variance = 2.0 * coefficient * np.log(10.0)
    return tuple((float(variance), float(tau)) for tau in np.geomspace(shortest, longest, count))


def energy(numerator: Polynomial, denominator: Polynomial) -> float:
    """Integral over f of |numerator / denominator|^2 at s = 2 pi i f, of a denominator up to s^3.

    It is the variance behind the filter of white noise of unit density (James, Nichols and
    Phillips, Theory of Servomechanisms, 1947, appendix).
    """
    order = len(denominator) - 1
    c = [0.0] * (order - len(numerator)) + list(numerator)
    d = list(denominator)
    if order == 1:
        (c0,), (d1, d0) = c, d
        return c0**2 / (2.0 * d0 * d1)
    if order == 2:
        (c1, c0), (d2, d1, d0) = c, d
        return (c1**2 * d0 + c0**2 * d2) / (2.0 * d0 * d1 * d2)
    (c2, c1, c0), (d3, d2, d1, d0) = c, d
    total = c2**2 * d0 * d1 + (c1**2 - 2.0 * c0 * c2) * d0 * d3 + c0**2 * d2 * d3
    return total / (2.0 * d0 * d3 * (d1 * d2 - d0 * d3))
