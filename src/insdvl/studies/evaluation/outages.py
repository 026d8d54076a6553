"""Outages of the DVL in a mission, and the errors at their ends.

An outage begins with the last ping before it, so at its end the filter has navigated without the
DVL for exactly its length, if the rate of the pings has one at these times. Its drift is by how
much the error of the position has changed meanwhile.
"""

from collections.abc import Mapping

import numpy as np

from insdvl.arrays import Array
from insdvl.studies.evaluation.metrics import nees

#: Begin and end of an outage [s] from the start of the mission.
Outage = tuple[float, float]

#: Time before the first outage, and between two [s]: whole intervals of pings at 0.2 Hz.
CONVERGENCE, RECOVERY = 90.0, 60.0
#: The last ping that is used is at the begin of an outage, and none is at its end [s].
_BEHIND = 0.05

#: Root mean squares over the outages of a mission at their ends: velocity in body axes [m/s],
#: horizontal and vertical drift [m].
ERRORS = ("outage_velocity", "outage_drift", "outage_depth")
#: Their NEES per degree of freedom, of the velocity, and of the position in the coordinates of the
#: model (`navigation.coordinates`), horizontal and vertical.
CONSISTENCY = ("nees_outage_velocity", "nees_outage_position", "nees_outage_depth")
METRICS = (*ERRORS, *CONSISTENCY)


def outages_in(duration: float, length: float) -> tuple[Outage, ...]:
    """All outages of a length that a mission has room for; none of the length 0.

    Args:
        duration: Of the mission [s].
        length: Of an outage [s].
    """
    if length == 0.0:
        return ()
    period = length + RECOVERY
    count = int((duration - CONVERGENCE + RECOVERY) / period)
    begins = [CONVERGENCE + k * period for k in range(count)]
    return tuple((begin, begin + length) for begin in begins)


def silence(outages: tuple[Outage, ...]) -> tuple[float, ...]:
    """The outages as `DvlModel.outages`."""
    return tuple(time + _BEHIND for outage in outages for time in outage)


def outside(t: Array, outages: tuple[Outage, ...]) -> Array:
    """Which of the times (N,) [s] are in no outage, as a mask."""
    mask = np.ones(t.size, dtype=bool)
    for begin, end in outages:
        mask &= (t <= begin) | (t > end)
    return mask


def errors_at_ends(
    outages: tuple[Outage, ...],
    t: Array,
    *,
    dv: Array,
    P_v: Array,
    dp: Array,
    P_p: Array,
    position: Array,
) -> Mapping[str, float]:
    """The `METRICS` of a mission with outages.

    Args:
        outages: At least one.
        t: (K,) times [s]; the nearest ones to the begins and ends are used.
        dv: (K, 3) errors of the velocity in body axes [m/s].
        P_v: (K, 3, 3) their covariances.
        dp: (K, 3) errors of the position in the coordinates of the model [m].
        P_p: (K, 3, 3) their covariances.
        position: (K, 3) errors of the position north, east and down [m].
    """
    begin, end = (np.abs(t[:, None] - times).argmin(axis=0) for times in np.array(outages).T)
    drift = position[end] - position[begin]
    horizontal, vertical = slice(0, 2), slice(2, 3)
    errors = dv[end], drift[:, horizontal], drift[:, vertical]
    judged = (
        (dv[end], P_v[end]),
        (dp[end, horizontal], P_p[end, horizontal, horizontal]),
        (dp[end, vertical], P_p[end, vertical, vertical]),
    )
    return {
        name: float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        for name, error in zip(ERRORS, errors, strict=True)
    } | {
        name: float(np.mean(nees(error, P))) / error.shape[1]
        for name, (error, P) in zip(CONSISTENCY, judged, strict=True)
    }
