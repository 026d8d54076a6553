"""The noise of a velocity sensor from its pings and the IMU between them.

Each ping, carried forward by the IMU, is the present velocity again: with the noise of the ping,
with gravity times the time since (the tilt need not be known), and with the noise that the IMU has
integrated. The third divided difference of four of them is free of everything that is a constant,
a line or a parabola in time: velocity, gravity, tilt, biases. What is left is noise of the pings,
and little of the IMU's, whatever Q the filter is told.
"""

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS

#: Pings beside the present one.
PAST = 3
#: Four pings that span more than this [s] are not compared: the IMU has drifted.
LONGEST = 10.0
#: Differences that a mean is taken from, at most and at least.
SIZE, FEWEST = 15, 5
#: A difference that is older than this [s] tells nothing of the present noise. Those of the slowest
#: pings that are compared, one in 3.3 s, are all used.
LIFE = (PAST + SIZE) * LONGEST / PAST
#: Median of a third of chi-squared with three degrees of freedom.
MEDIAN = 2.365974 / 3.0


def weights(stamps_ns: Stamps) -> Array:
    """Weights (4,) of the third divided difference at stamps (4,), their squares' sum 1.

    w_i is proportional to 1 / prod (t_i - t_j): for equal intervals (1, -3, 3, -1) / sqrt(20).
    """
    t = (stamps_ns - stamps_ns[0]) / NS
    apart = t[:, None] - t[None, :] + np.eye(len(t))
    w = 1.0 / np.prod(apart, axis=1)
    return np.asarray(w / np.linalg.norm(w))


def difference_square(stamps_ns: Stamps, velocities: Array, covariances: Array) -> float:
    """Mean square of the third difference of four pings, in units of their noise.

    Its expectation is the factor lambda on the covariances, and what the IMU adds.

    Args:
        stamps_ns: (4,) stamps, all different.
        velocities: (4, 3) pings, carried forward to the last one [m/s].
        covariances: (4, 3, 3) nominal covariance of each one's noise, in the same axes.

    Returns:
        nan where the covariances are singular.
    """
    w = weights(stamps_ns)
    difference = w @ velocities
    covariance = np.einsum("i,ijk->jk", w**2, covariances)
    try:
        return float(difference @ np.linalg.solve(covariance, difference)) / len(difference)
    except np.linalg.LinAlgError:
        return np.nan


def recent(squares: Array, stamps_ns: Stamps, at_ns: int) -> Array:
    """Those of the squares (n,), whose stamps are (n,), that tell something at a stamp."""
    return squares[stamps_ns >= at_ns - round(LIFE * NS)]


def mean_factor(squares: Array) -> float | None:
    """The factor from squares (n,) of Gaussian noise: their mean; None for too few."""
    return float(np.mean(squares)) if len(squares) >= FEWEST else None


def median_factor(squares: Array) -> float | None:
    """The factor from squares (n,) with the same expectation, some of which may be of wild pings.

    Their median over that of a mean of three squared normal numbers; None for too few.
    """
    return float(np.median(squares)) / MEDIAN if len(squares) >= FEWEST else None
