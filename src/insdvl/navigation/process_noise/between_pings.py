"""The error states of the published filter over the time between two pings, in one step.

In NED, with the noise n_f of the accelerometers and n_w of the gyroscopes, and errors of the biases
db_f and db_w in base_link axes,

    dv' = [g x] psi - C db_f + n_f + [v x] (n_w - C db_w),   psi' = n_w - C db_w,

and of the position in metres dp' = dv - [v x] psi. Attitude and velocity are those of the step's
end; the Earth's rate, the transport rate and Coriolis' acceleration are left out. For `ned` there
is no [v x]. Derivation: docs/explanation/process-noise-factor.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
    add_block,
    set_block,
)
from insdvl.navigation.geometry.rotation import product, product_transposed

# First elements of the blocks, for the kernels.
_V, _A, _F, _W = VELOCITY.start, ATTITUDE.start, ACCELEROMETER_BIAS.start, GYROSCOPE_BIAS.start
_P = POSITION.start


@kernel
def set_transition(Phi: Array, C_n_b: Array, v_x: Array, g_x: Array, t: float) -> None:
    """Set the blocks of a transition that is the identity before.

    Args:
        Phi: (12, 12) result: velocity, attitude, biases of accelerometers and gyroscopes; others
            may follow.
        C_n_b: (3, 3) attitude.
        v_x: (3, 3) [v x], or zero for the error state `ned`.
        g_x: (3, 3) [g x].
        t: Length of the step [s].
    """
    B, M = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            B[i, j] = v_x[i, j] * t + 0.5 * t * t * g_x[i, j]
    product(M, B, C_n_b)
    set_block(Phi, _V, _A, t, g_x)
    set_block(Phi, _V, _F, -t, C_n_b)
    set_block(Phi, _V, _W, -1.0, M)
    set_block(Phi, _A, _W, -t, C_n_b)


@kernel
def add_noise(P: Array, S_f: Array, S_w: Array, v_x: Array, g_x: Array, t: float) -> None:
    """Add to a covariance (12, 12) what the noise of the IMU makes within a step.

    Args:
        P: (12, 12) covariance after the transition; others may follow.
        S_f: (3, 3) density of the noise of the specific force, NED.
        S_w: (3, 3) of the angular rate, NED.
        v_x: (3, 3) [v x], or zero for the error state `ned`.
        g_x: (3, 3) [g x].
        t: Length of the step [s].
    """
    of_v, of_g, M = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    product(of_v, v_x, S_w)
    product(of_g, g_x, S_w)
    add_block(P, _V, _V, t, S_f)
    product_transposed(M, of_v, v_x)
    add_block(P, _V, _V, t, M)
    product_transposed(M, of_g, g_x)
    add_block(P, _V, _V, t**3 / 3.0, M)
    product_transposed(M, of_v, g_x)
    for i in range(3):
        for j in range(3):
            P[_V + i, _V + j] += 0.5 * t * t * (M[i, j] + M[j, i])
            cross = t * of_v[i, j] + 0.5 * t * t * of_g[i, j]
            P[_V + i, _A + j] += cross
            P[_A + j, _V + i] += cross
    add_block(P, _A, _A, t, S_w)


@kernel
def set_transition_of_position(Phi: Array, C_n_b: Array, v_x: Array, g_x: Array, t: float) -> None:
    """Set the rows of the position in metres of a transition that is the identity before.

    Args:
        Phi: (15, 15) result.
        C_n_b: (3, 3) attitude.
        v_x: (3, 3) [v x], or zero for the error state `ned`.
        g_x: (3, 3) [g x].
        t: Length of the step [s].
    """
    of_psi, M = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        Phi[_P + i, _V + i] = t
        for j in range(3):
            of_psi[i, j] = 0.5 * t * t * g_x[i, j] - t * v_x[i, j]
    product(M, g_x, C_n_b)
    set_block(Phi, _P, _A, 1.0, of_psi)
    set_block(Phi, _P, _F, -0.5 * t * t, C_n_b)
    set_block(Phi, _P, _W, -(t**3) / 6.0, M)


@kernel
def add_noise_of_position(
    P: Array, S_f: Array, S_w: Array, v_x: Array, g_x: Array, t: float
) -> None:
    """Add to a covariance what the noise of the IMU makes of the position, beside `add_noise`.

    An impulse n_w at the time u before the end leaves psi = n_w, dv = ([v x] + u [g x]) n_w and
    dp = u^2 / 2 [g x] n_w; one of n_f leaves dv = n_f and dp = u n_f. The products are integrated
    over the step.

    Args:
        P: (15, 15) covariance after the transition.
        S_f: (3, 3) density of the noise of the specific force, NED.
        S_w: (3, 3) of the angular rate, NED.
        v_x: (3, 3) [v x], or zero for the error state `ned`.
        g_x: (3, 3) [g x].
        t: Length of the step [s].
    """
    of_g, of_gg, of_gv = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    product(of_g, g_x, S_w)
    product_transposed(of_gg, of_g, g_x)
    product_transposed(of_gv, of_g, v_x)
    for i in range(3):
        for j in range(3):
            P[_P + i, _P + j] += t**3 / 3.0 * S_f[i, j] + t**5 / 20.0 * of_gg[i, j]
            of_v = t**2 / 2.0 * S_f[i, j] + t**3 / 6.0 * of_gv[i, j] + t**4 / 8.0 * of_gg[i, j]
            of_psi = t**3 / 6.0 * of_g[i, j]
            P[_P + i, _V + j] += of_v
            P[_V + j, _P + i] += of_v
            P[_P + i, _A + j] += of_psi
            P[_A + j, _P + i] += of_psi
