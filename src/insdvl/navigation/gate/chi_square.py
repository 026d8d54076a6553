"""Quantiles of the chi-square distribution; scipy has them too, but takes long to import."""

import math
from functools import cache


@cache
def exceeded(dof: int, tail: float) -> float:
    """The value that is exceeded with a probability `tail` in (0, 1).

    Args:
        dof: Degrees of freedom, at least 1.
        tail: The probability.
    """
    low, high = 0.0, 1.0
    while _tail(high, dof) > tail:
        low, high = high, 2.0 * high
    while low < (middle := (low + high) / 2.0) < high:
        low, high = (middle, high) if _tail(middle, dof) > tail else (low, middle)
    return high


def _tail(x: float, dof: int) -> float:
    """Probability that x >= 0 is exceeded.

    It is Q(dof / 2, x / 2), a finite sum for an integer: Abramowitz and Stegun, Handbook of
    Mathematical Functions, 1964, eqs. (26.4.4) and (26.4.5).
    """
    h = x / 2.0
    if dof % 2:
        total, k = math.erfc(math.sqrt(h)), 1.5
        term = 2.0 * math.sqrt(h / math.pi) * math.exp(-h)
    else:
        total, k, term = 0.0, 1.0, math.exp(-h)
    while k <= dof / 2.0:
        total += term
        term *= h / k
        k += 1.0
    return total
