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
    """Probability that x > 0 is exceeded.

    It is Q(dof / 2, x / 2), a finite sum for an integer: Abramowitz and Stegun, Handbook of
    Mathematical Functions, 1964, eqs. (26.4.4) and (26.4.5).
    """
    h, k = x / 2.0, 0.5 * (dof % 2)
    total = math.erfc(math.sqrt(h)) if dof % 2 else 0.0
    while k < dof / 2.0:
        total += math.exp(k * math.log(h) - h - math.lgamma(k + 1.0))  # no underflow at a large dof
        k += 1.0
    return total
