"""The residuals of a window of motion, and their derivatives by what is unknown of the sensors.

The derivation is in docs/explanation/alignment.md. With the right values, in each window

    y(t) = R (C v_d - kappa w x l) - kappa F,   kappa = 1 / scale,

is a parabola in t but for the noise of the DVL; the scale stands at the IMU's side, so that this
noise, which is in v_d, is the same for every C and does not bias it.
"""

import math
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.navigation.geometry.rotation import cross, product, rotate, skew
from insdvl.watch.alignment.windows import Window

#: Columns of the unknowns: a turn of the DVL [rad], ln(kappa), change of the lever arm [m], delay
#: of the DVL [s], biases [m/s^2, rad/s], relative error of the gyroscope's scale.
MOUNT = slice(0, 3)
YAW = 2
SCALE = 3
ARM = slice(4, 7)
DELAY = 7
ACCELEROMETER = slice(8, 11)
GYROSCOPE = slice(11, 14)
GYROSCOPE_SCALE = 14
SIZE = 15

# First columns of the blocks, for the kernel.
_ARM, _F, _W = ARM.start, ACCELEROMETER.start, GYROSCOPE.start


@dataclass(frozen=True)
class Mounted:
    """The mount of the DVL as the parameters tell it, in body axes.

    Attributes:
        C_b_d: (3, 3) DVL to body.
        l_b: (3,) from the IMU to the DVL [m].
    """

    C_b_d: Array
    l_b: Array


def rows(w: Window, known: Mounted, x: Array) -> Array:
    """Partial derivatives of y by the unknowns, and y itself in the last column (K, 3, 16).

    Args:
        w: K pings.
        known: The mount from which the unknowns count.
        x: (15,) values of the unknowns.
    """
    out = np.empty((len(w.t), 3, SIZE + 1))
    turned = w.v_d @ (rotation_from_vector(x[MOUNT]) @ known.C_b_d).T
    kappa = math.exp(x[SCALE])
    _rows(out, turned, w.R, w.F, w.Phi, w.Psi, w.xi, w.Xi, w.w, w.f, known.l_b + x[ARM], kappa, x)
    return out


@kernel
def _rows(
    out: Array,
    turned: Array,
    R: Array,
    F: Array,
    Phi: Array,
    Psi: Array,
    xi: Array,
    Xi: Array,
    w: Array,
    f: Array,
    l_b: Array,
    kappa: float,
    x: Array,
) -> None:
    """The rows (K, 3, 16) of `rows`.

    With u = C v_d - kappa w x l, angle and F' what the errors of the IMU change of turn and F,
    y = R u - angle x R u - kappa F' - delay R (w x u - kappa f).

    Args:
        out: (K, 3, 16) result.
        turned: (K, 3) C v_d.
        R, F, Phi, Psi, xi, Xi, w, f: Of the window.
        l_b: (3,) from the IMU to the DVL [m].
        kappa: 1 / scale.
        x: (15,) values of the unknowns.
    """
    b_f, b_w, scale = x[_F : _F + 3], x[_W : _W + 3], x[GYROSCOPE_SCALE]
    u, across, angle, force = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    Ru, R_turned, moved = np.empty(3), np.empty(3), np.empty(3)
    S, M = np.empty((3, 3)), np.empty((3, 3))
    for k in range(out.shape[0]):
        a = out[k]
        cross(across, w[k], l_b)
        for i in range(3):
            u[i] = turned[k, i] - kappa * across[i]
        rotate(Ru, R[k], u)
        rotate(R_turned, R[k], turned[k])
        cross(across, w[k], u)
        for i in range(3):
            across[i] -= kappa * f[k, i]
        rotate(moved, R[k], across)
        for i in range(3):
            angle[i] = xi[k, i] * scale
            force[i] = F[k, i] - Xi[k, i] * scale
            for j in range(3):
                angle[i] += Phi[k, i, j] * b_w[j]
                force[i] -= Phi[k, i, j] * b_f[j] + Psi[k, i, j] * b_w[j]
        skew(S, turned[k])
        product(M, R[k], S)
        for i in range(3):
            for j in range(3):
                a[i, j] = -M[i, j]
        skew(S, w[k])
        product(M, R[k], S)
        for i in range(3):
            for j in range(3):
                a[i, _ARM + j] = -kappa * M[i, j]
        skew(S, Ru)
        product(M, S, Phi[k])
        for i in range(3):
            for j in range(3):
                a[i, _F + j] = kappa * Phi[k, i, j]
                a[i, _W + j] = M[i, j] + kappa * Psi[k, i, j]
        cross(across, Ru, xi[k])
        for i in range(3):
            a[i, SCALE] = Ru[i] - R_turned[i] - kappa * force[i]
            a[i, DELAY] = -moved[i]
            a[i, GYROSCOPE_SCALE] = across[i] + kappa * Xi[k, i]
        cross(across, angle, Ru)
        for i in range(3):
            a[i, SIZE] = Ru[i] - across[i] - kappa * force[i] - x[DELAY] * moved[i]
