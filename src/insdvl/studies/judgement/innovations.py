"""What the innovations of one kind of measurement say, as numbers with their bounds.

The innovations of a filter that is as good as it says are white, have the mean zero and the
covariance S. Each bound here is that which such a filter exceeds with the probability `CHANCE`; the
derivations are in docs/explanation/verdict.md.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from insdvl.arrays import Array
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.studies.evaluation.metrics import autocorrelation, normalised_innovations
from insdvl.watch.consistency import nis_interval, nis_median, scaled_nis

#: Probability of a false alarm of each rule.
CHANCE = 1e-3
#: Sigmas of a normal number that is beyond its bound by chance, on either side.
SIGMAS = float(-ndtri(CHANCE / 2.0))
#: A sigma is seldom known better than by this factor; what is nearer to right is no finding.
FACTOR = 1.5
#: Sigmas that an innovation has at most in the autocorrelation: one outlier decides nothing.
OUTLIER = 4.0
#: Fewest judged measurements from which anything is concluded.
FEWEST = 30


def mean_nis_bounds(rows: int, count: int) -> tuple[float, float]:
    """Bounds of the mean of so many NIS of m rows: their sum is chi-square with m times as many."""
    return nis_interval(rows, count, 1.0 - CHANCE)


def median_nis_bounds(rows: int, count: int) -> tuple[float, float]:
    """Bounds of the median of so many NIS of m rows.

    It is below a value if more than half of them are, whose number is binomial: the bounds are the
    quantiles that are half of SIGMAS / sqrt(n) off the middle.
    """
    width = SIGMAS / (2.0 * math.sqrt(count))
    return exceeded(rows, 0.5 + width), exceeded(rows, 0.5 - width)


def judged_of(reports: Sequence[UpdateReport]) -> list[UpdateReport]:
    """Those that were compared with a prediction in all rows."""
    return [r for r in reports if r.judged and r.rows == len(r.innovation)]


def statistics(reports: Sequence[UpdateReport]) -> dict[str, Any] | None:
    """Numbers of the judged measurements of one kind; None where they are too few.

    ``nis_mean`` is over all that were judged, accepted or not, with ``nis_expected`` and
    ``nis_bounds``; ``nis_median`` with its own, which outliers do not move. ``autocorrelation`` is
    that of the normalised innovations at lag one, with ``autocorrelation_bound``. ``mean`` is the
    mean innovation in each row, and ``mean_in_standard_errors`` that over its standard error, which
    is larger where near ones are correlated.
    """
    judged = judged_of(reports)
    if len(judged) < FEWEST:
        return None
    nu = np.array([r.innovation for r in judged])
    S = np.array([r.S for r in judged])
    nis = np.array([scaled_nis(r) for r in judged])
    count, rows = nu.shape
    z = np.clip(normalised_innovations(nu, S), -OUTLIER, OUTLIER)
    rho = autocorrelation(z, 1)[0]
    mean = nu.mean(axis=0)
    error = np.array([_error_of_mean(row) for row in nu.T])
    return {
        "judged": count,
        "nis_mean": float(nis.mean()),
        "nis_expected": float(rows),
        "nis_bounds": mean_nis_bounds(rows, count),
        "nis_median": float(np.median(nis)),
        "nis_median_expected": nis_median(rows),
        "nis_median_bounds": median_nis_bounds(rows, count),
        "autocorrelation": rho,
        "autocorrelation_bound": SIGMAS / math.sqrt(rows * count),
        "mean": mean.tolist(),
        "mean_in_standard_errors": _divided(mean, error),
        "mean_in_sigmas": _divided(mean, np.sqrt(np.mean(np.diagonal(S, axis1=1, axis2=2), 0))),
    }


def variance_of_sum(values: Array) -> float:
    """Variance of a sum whose terms differ in size and are correlated with near ones.

    Newey and West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
    consistent covariance matrix, Econometrica 55 (1987).
    """
    lags = int(4.0 * (len(values) / 100.0) ** (2.0 / 9.0))
    total = float(values @ values)
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * float(values[lag:] @ values[:-lag])
    return total


def _error_of_mean(values: Array) -> float:
    """Standard error of a mean (N,), not below that of white values."""
    left, count = values - values.mean(), len(values)
    white = count / (count - 1.0) * float(left @ left)
    return math.sqrt(max(white, variance_of_sum(left))) / count


def _divided(values: Array, by: Array) -> list[float]:
    return np.divide(values, by, out=np.zeros_like(values), where=by > 0.0).tolist()
