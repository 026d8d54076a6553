"""The ordinary DVL measurement, from its linearisation to the corrected state, in one kernel.

It does what `Filter.update` does with a measurement that nothing speaks against, by the same
functions in the same order. A call from Python costs as much as all of its mathematics; here is one
in the place of nine.
"""

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import channels, kalman, map_to_odom
from insdvl.navigation.gate import ordinary
from insdvl.navigation.geometry.rotation import copy_matrix
from insdvl.navigation.measurements.dvl_jacobian import linearise


@kernel
def take_in(
    state: Records,
    memory: Records,
    workspace: Records,
    constants: Records,
    C_d_b: Array,
    l_b: Array,
    error_at: int,
    mount_at: int,
    noise: Array,
    v_d: Array,
    w_ib_b: Array,
    share: Array,
    limits: Array,
    stamp_ns: int,
    patience_ns: int,
    innovation: Array,
    S: Array,
) -> float:
    """Judge a measurement and correct the state, if nothing speaks against it.

    Args:
        state: (1,) record at the measurement, initialised.
        memory: (1,) of the gate, a part of it.
        workspace: (1,) of the filter.
        constants: (1,) of the filter.
        C_d_b: (3, 3) rotation from base_link to DVL axes.
        l_b: (3,) from the IMU to the DVL [m], base_link axes.
        error_at: First index of the DVL's error states, or `ABSENT`.
        mount_at: The same of its mount.
        noise: (3, 3) covariance of its noise [(m/s)^2].
        v_d: (3,) measured velocity [m/s], DVL axes.
        w_ib_b: (3,) angular rate at the stamp [rad/s], base_link axes.
        share: (3,) its variance, in units of that of one sample.
        limits: (4,) of the NIS, by the number of rows that were measured.
        stamp_ns: Of the measurement.
        patience_ns: Most trust that the filter gains.
        innovation: (3,) result, measured minus predicted.
        S: (3, 3) result, its covariance.

    Returns:
        The NIS; nan where the measurement is not ordinary, and the state is as it was.
    """
    s, n, w_covariance = state[0], constants[0].n, np.empty((3, 3))
    if channels.turn_noise(state, constants, share, w_covariance):
        return np.nan
    H, own = np.zeros((3, n)), np.empty((3, 3))
    of_dvl = C_d_b, l_b, error_at, mount_at, noise, w_ib_b, w_covariance
    for i in range(3):
        innovation[i] = v_d[i]
    linearise(state, workspace, constants, *of_dvl, innovation, H, own)
    R, K = np.empty((3, 3)), np.empty((n, 3))
    nis, _, used = ordinary.is_ordinary(
        state, memory, constants, stamp_ns, innovation, H, own, limits, R, S, K
    )
    if not used:
        return np.nan
    C_before, llh_before = np.empty((3, 3)), s.nav.llh.copy()
    copy_matrix(C_before, s.nav.C_n_b)
    if constants[0].invariant:
        kalman.correct_body_velocity(state, constants, H, K, R, innovation, workspace)
    else:
        kalman.correct_linearly(state, constants, H, K, R, innovation, workspace)
    left, H_after, R_after = v_d.copy(), np.zeros((3, n)), np.empty((3, 3))
    linearise(state, workspace, constants, *of_dvl, left, H_after, R_after)
    ordinary.accept(state, memory, constants, stamp_ns, H, K, left, patience_ns, True)
    map_to_odom.move_odom(state, C_before, llh_before)
    memory[0].judged_ns = stamp_ns
    return nis
