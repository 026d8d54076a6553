"""The samples of an IMU between two times as one turn and one change of velocity.

They do not depend on the noise that a filter is told, so one integration serves any number of
evaluations of a likelihood.
"""

from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.rotation import exponential, product, rotate


class Increments(NamedTuple):
    """Integrals over J steps, in the axes of the IMU at the begin of each.

    Attributes:
        seconds: (J,) lengths [s].
        turn: (J, 3, 3) rotation from the axes at the end of a step to those at its begin.
        dv: (J, 3) integral of the specific force [m/s].
    """

    seconds: Array
    turn: Array
    dv: Array


def increments(
    stamps_ns: Stamps, f_b: Array, w_ib_b: Array, bias: Array, bounds_ns: Stamps
) -> Increments:
    """Integrate samples, each the mean over the interval that ends at its stamp.

    Args:
        stamps_ns: (N,) stamps, increasing.
        f_b: (N, 3) specific force [m/s^2].
        w_ib_b: (N, 3) angular rate [rad/s].
        bias: (6,) of both, removed from all samples.
        bounds_ns: (J + 1,) begins and ends of the steps, increasing, within the first and the last
            stamp.
    """
    count = len(bounds_ns) - 1
    turn, dv = np.empty((count, 3, 3)), np.empty((count, 3))
    readings = np.hstack([f_b, w_ib_b]) - bias
    _integrate(stamps_ns, readings, bounds_ns, turn, dv)
    return Increments(np.diff(bounds_ns) / NS, turn, dv)


@kernel
def _integrate(
    stamps_ns: Stamps, readings: Array, bounds_ns: Stamps, turn: Array, dv: Array
) -> None:
    C, mean, step, R = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    f, moved, summed = np.empty(3), np.empty(3), np.empty(3)
    k = 1
    for j in range(len(bounds_ns) - 1):
        begin, end = bounds_ns[j], bounds_ns[j + 1]
        C[:] = np.eye(3)
        summed[:] = 0.0
        while stamps_ns[k] <= begin:
            k += 1
        while begin < end:
            until = min(end, stamps_ns[k])
            dt = (until - begin) / 1e9
            x, y, z = readings[k, 3] * dt, readings[k, 4] * dt, readings[k, 5] * dt
            exponential(step, mean, x, y, z)
            for i in range(3):
                f[i] = readings[k, i] * dt
            rotate(moved, mean, f)
            rotate(f, C, moved)
            for i in range(3):
                summed[i] += f[i]
            product(R, C, step)
            C[:] = R
            begin = until
            if begin < end:
                k += 1
        turn[j], dv[j] = C, summed
