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
    low, high = 0.0, float(dof)
    while _tail(high, dof) > tail:
        low, high = high, 2.0 * high
    while low < (middle := (low + high) / 2.0) < high:
        low, high = (middle, high) if _tail(middle, dof) > tail else (low, middle)
    return high


def _tail(x: float, dof: int) -> float:
    """Probability that x >= 0 is exceeded: Q(a, h), a = dof / 2, h = x / 2.

    By the series of P = 1 - Q for a small h, else by the continued fraction of Q: Abramowitz and
    Stegun, Handbook of Mathematical Functions, 1964, eqs. (6.5.29) and (6.5.31).
    """
    a, h = dof / 2.0, x / 2.0
    if h == 0.0:
        return 1.0
    front = math.exp(a * math.log(h) - h - math.lgamma(a))
    if h < a + 1.0:
        k, term, total = a, 1.0 / a, 1.0 / a
        while term > 1e-17 * total:
            k += 1.0
            term *= h / k
            total += term
        return 1.0 - front * total
    # Evaluated forwards (Lentz): d and c are ratios of successive denominators and numerators.
    k, b = 0.0, h + 1.0 - a
    c, d = math.inf, 1.0 / b
    total, factor = d, 0.0
    while abs(factor - 1.0) > 1e-15:
        k += 1.0
        b += 2.0
        d = 1.0 / (b - k * (k - a) * d)
        c = b - k * (k - a) / c
        factor = c * d
        total *= factor
    return front * total
