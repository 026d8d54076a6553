"""What the innovations say of the filter's covariance."""

import math
from functools import cache

from insdvl.navigation.filter import UpdateReport
from insdvl.navigation.gate.chi_square import exceeded


def nis_median(rows: int) -> float:
    """Median of the normalised innovation squared of a consistent filter.

    It is chi-square with as many degrees of freedom as the measurement has rows.
    """
    return exceeded(rows, 0.5)


@cache
def nis_median_limit(rows: int, count: int, probability: float) -> float:
    """What the median NIS of a consistent filter exceeds with no more than a probability.

    It does so only where at least half of the NIS do, whose number is binomial.

    Args:
        rows: Of each measurement.
        count: Number of independent measurements.
        probability: Between 0 and 0.5.
    """
    half = (count + 1) // 2
    low, high = 0.0, 0.5  # of the probability that one of them exceeds it
    while low < (middle := (low + high) / 2.0) < high:
        terms = (
            math.comb(count, k) * middle**k * (1.0 - middle) ** (count - k)
            for k in range(half, count + 1)
        )
        low, high = (low, middle) if sum(terms) > probability else (middle, high)
    return exceeded(rows, low)


def scaled_nis(report: UpdateReport) -> float:
    """The NIS of a judged measurement, scaled to all rows where some of them were not measured."""
    return report.nis * (len(report.innovation) / report.rows)


def nis_interval(rows: int, count: int, probability: float) -> tuple[float, float]:
    """Where the mean NIS of a consistent filter lies with a probability, half beyond each end.

    Args:
        rows: Of each measurement.
        count: Number of independent measurements.
        probability: Between 0 and 1.
    """
    tail = (1.0 - probability) / 2.0
    return exceeded(rows * count, 1.0 - tail) / count, exceeded(rows * count, tail) / count
