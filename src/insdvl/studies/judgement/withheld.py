"""How well the filter predicts DVL measurements that it was not given: a score without a reference.

The measurements of a window are withheld, and the first one after it is predicted. What the filter
has drifted meanwhile, and what it says it has, are compared (docs/explanation/verdict.md).
"""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS, Event
from insdvl.navigation.gate.chi_square import exceeded
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.studies.judgement.innovations import mean_nis_bounds
from insdvl.studies.replay.taken import Taken

#: Lengths of the windows [s].
WINDOWS = (10.0, 30.0, 60.0)
#: Time before the first window, and between two [s]: the filter recovers.
RECOVERY = 20.0
GRAVITY = 9.81  # m/s^2
#: Probability of the region of which the coverage is told.
REGION = 0.95


@dataclass(frozen=True)
class Withheld:
    """Predictions of the first measurement after windows of one length.

    Attributes:
        seconds: Length of the windows.
        count: Number of predictions.
        error: RMS of the predicted velocity's error, all components together [m/s].
        sigma: What the filter expected of it [m/s].
        nis_mean: Mean NIS, 3 if the filter is as good as it says.
        nis_bounds: Of that, by chance.
        nis_of_curvature: By so much the mean NIS of a right filter is larger, see `of_curvature`.
        log_likelihood: Mean, of one measurement.
        covered: Share within the region of 95 %.
    """

    seconds: float
    count: int
    error: float
    sigma: float
    nis_mean: float
    nis_bounds: tuple[float, float]
    nis_of_curvature: float
    log_likelihood: float
    covered: float


def predictions(
    taken: Taken, parameters: FilterParameters, used: set[int], seconds: float
) -> Withheld | None:
    """Withhold windows of one length; None where there is no room for one.

    Args:
        taken: What was folded.
        parameters: Of the filter.
        used: Stamps of the DVL measurements that the filter accepted; the first of them after a
            window is predicted.
        seconds: Length of the windows.
    """
    given, predicted = _chosen(taken.events, used, seconds)
    if not predicted:
        return None
    reports = [
        update.report
        for update in taken.folded(parameters, given).updates
        if update.report.measurement == Dvl.name
        and update.stamp_ns in predicted
        and update.report.judged
        and update.report.rows == len(update.report.innovation)
    ]
    if not reports:
        return None
    nu = np.array([report.innovation for report in reports])
    S = np.array([report.S for report in reports])
    nis = np.array([report.nis for report in reports])
    count, rows = nu.shape
    log_likelihood = -0.5 * (nis + np.linalg.slogdet(2.0 * math.pi * S)[1])
    return Withheld(
        seconds=seconds,
        count=count,
        error=float(np.sqrt(np.mean(np.sum(nu**2, axis=1)))),
        sigma=float(np.sqrt(np.mean(np.trace(S, axis1=1, axis2=2)))),
        nis_mean=float(nis.mean()),
        nis_bounds=mean_nis_bounds(rows, count),
        nis_of_curvature=float(np.mean(of_curvature(S, seconds))),
        log_likelihood=float(log_likelihood.mean()),
        covered=float(np.mean(nis <= exceeded(rows, 1.0 - REGION))),
    )


def of_curvature(S: Array, seconds: float) -> Array:
    """What a large tilt adds to the NIS of a filter that is as good as it says (K,).

    A filter is linear in the tilt, and gravity is not: by its cosine a tilt of variance q t about
    each level axis changes the vertical velocity by g q t^2 / 2 on average, and by 5/3 of the
    square of that in the mean square. The level velocity shows q: its variance is g^2 q t^3 / 3.

    Args:
        S: (K, 3, 3) covariances of the innovations [(m/s)^2].
        seconds: Since the last measurement.
    """
    variances = np.linalg.eigvalsh(S)
    falls = 1.5 * variances[:, -1] / (GRAVITY * seconds)
    return np.asarray(5.0 / 3.0 * falls**2 / variances[:, 0])


def _chosen(events: list[Event], used: set[int], seconds: float) -> tuple[list[Event], set[int]]:
    """The events without what is withheld, and the stamps of the measurements to predict."""
    pings = sorted(e.stamp_ns for e in events if isinstance(e, Dvl))
    length_ns, recovery_ns = round(seconds * NS), round(RECOVERY * NS)
    withheld: set[int] = set()
    predicted: set[int] = set()
    good = [stamp_ns for stamp_ns in pings if stamp_ns in used]
    if not good:
        return events, predicted
    begin_ns = good[0] + recovery_ns
    while (k := bisect_right(good, begin_ns + length_ns)) < len(good):
        withheld.update(pings[bisect_right(pings, begin_ns) : bisect_left(pings, good[k])])
        predicted.add(good[k])
        begin_ns = good[k] + recovery_ns
    given = [e for e in events if not isinstance(e, Dvl) or e.stamp_ns not in withheld]
    return given, predicted
