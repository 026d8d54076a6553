"""The innovation of a DVL and its derivatives, as kernels (docs/explanation/error-state.md)."""

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import error_state
from insdvl.navigation.error_state import ATTITUDE, GYROSCOPE_BIAS, VELOCITY
from insdvl.navigation.geometry.rotation import (
    copy_matrix,
    cross,
    exponential,
    product,
    product_transposed,
    rotate,
    rotate_back,
    skew,
)
from insdvl.navigation.prediction.strapdown import turn_rate
from insdvl.navigation.state.fields import CORE, State
from insdvl.navigation.state.scratch import Constants, Workspace

# First elements of the blocks, for the kernel.
_VELOCITY, _ATTITUDE, _GYROSCOPE_BIAS = VELOCITY.start, ATTITUDE.start, GYROSCOPE_BIAS.start
#: Of optional error states that are not in use.
ABSENT = -1


@kernel
def linearise(
    state: Records,
    workspace: Records,
    constants: Records,
    C_d_b: Array,
    l_b: Array,
    error_at: int,
    mount_at: int,
    noise: Array,
    w_ib_b: Array,
    w_covariance: Array,
    z_minus_h: Array,
    H: Array,
    R: Array,
) -> None:
    """Innovation, H and R of `DvlModel.linearise`; ``z_minus_h`` (3,) has z and becomes z - h."""
    s, optional = state[0], state[0].nav.optional
    C, h, arm = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    copy_matrix(C, C_d_b)
    J, M = np.empty((3, 3)), np.empty((3, 3))
    if mount_at != ABSENT:
        # exp(-[m x]) turns by the mount that is estimated beside dvl.mount; J is its mean.
        k = mount_at - CORE
        exponential(M, J, -optional[k], -optional[k + 1], -optional[k + 2])
        product(C, M, C_d_b)
    _predict(s, workspace[0], constants[0], C, l_b, w_ib_b, h, H, arm)
    if mount_at != ABSENT:
        h_x = np.empty((3, 3))
        skew(h_x, h)
        product(M, h_x, J)
        error_state.set_block(H, 0, mount_at, 1.0, M)
    for i in range(3):
        z_minus_h[i] -= h[i]
        if error_at != ABSENT:
            H[i, error_at + i] = 1.0
            z_minus_h[i] -= optional[error_at - CORE + i]
    product(M, arm, w_covariance)
    product_transposed(J, M, arm)
    for i in range(3):
        for j in range(3):
            R[i, j] = ((noise[i, j] + J[i, j]) + (noise[j, i] + J[j, i])) / 2.0


@kernel
def _predict(
    s: State,
    w: Workspace,
    c: Constants,
    C_d_b: Array,
    l_b: Array,
    w_ib_b: Array,
    h: Array,
    H: Array,
    arm: Array,
) -> None:
    """h (3,) without the DVL's own error, and its Jacobian H (3, n) in the first 15 columns.

    ``arm`` (3, 3) is C_d_b [l x], by which the turn rate counts.
    """
    nav = s.nav
    M, N, a_x = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    rate, w_nb_b, v_b, v_l = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        rate[i] = w_ib_b[i] - nav.b_w[i]
    turn_rate(w_nb_b, s, w, c, rate)
    rotate_back(v_b, nav.C_n_b, nav.v_n)
    cross(v_l, w_nb_b, l_b)
    for i in range(3):
        v_l[i] += v_b[i]
    rotate(h, C_d_b, v_l)

    product_transposed(M, C_d_b, nav.C_n_b)
    error_state.set_block(H, 0, _VELOCITY, 1.0, M)
    if not c.invariant:
        skew(a_x, nav.v_n)
        product(N, M, a_x)
        error_state.set_block(H, 0, _ATTITUDE, 1.0, N)
    skew(a_x, l_b)
    product(arm, C_d_b, a_x)
    error_state.set_block(H, 0, _GYROSCOPE_BIAS, 1.0, arm)
    product_transposed(M, arm, nav.C_n_b)
    skew(a_x, w.w_in_n)
    product(N, M, a_x)
    error_state.add_block(H, 0, _ATTITUDE, 1.0, N)
