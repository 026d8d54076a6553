"""Coordinates of the error: what an error of a state is, and what it is when the state moves.

With b_true = b + db, psi = (tilt about north and east, heading h about down), and

    ned:        C_true = exp([psi x]) C
                v_true = v + dv
                p_true = p + dp
    invariant:  C_true = R_h R_t C                  R_h = exp([h e_D x]), R_t = exp([t x])
                v_true = R_h (R_t v + dv)           (dv_i = dv_ned + [v x] psi to first order)
                p_true = r + R_h (R_t x + dp)       (dp_i = dp_ned + [x x] psi to first order)

where t is psi without the heading and x = p - r the position from the reference r, the point whose
position was known when the heading was not: the start. A heading error turns all else, the path
travelled since the start with it: whatever its size it is in neither the motion nor the velocity
that a DVL measures, apart from the Earth's rotation.
Positions are places on the Earth, and their differences metres north, east and down
(`geometry.earth.displacement`) in the axes at the vehicle.

Derived in docs/explanation/error-state.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.error_state import ATTITUDE, POSITION, VELOCITY, set_block
from insdvl.navigation.geometry import earth
from insdvl.navigation.geometry.frames import rotation_from_vector, vector_from_rotation
from insdvl.navigation.geometry.rotation import (
    about_down,
    copy_matrix,
    cross_matrix,
    exponential,
    orthonormalise,
    product,
    rotate,
    skew,
)
from insdvl.navigation.state.fields import CORE, State
from insdvl.navigation.state.scratch import Constants

# First elements of the blocks, for the kernels.
_V, _A, _F, _W, _P = 0, 3, 6, 9, 12

_DOWN = np.array([0.0, 0.0, 1.0])


@kernel
def inject(s: State, c: Constants, dx: Array) -> None:
    """Move the nominal state by the error dx (n,), and P into the axes of the new heading.

    There is no reset Jacobian of the tilt: that and the curvature of h cancel
    (docs/explanation/error-state.md).
    """
    nav = s.nav
    for i in range(3):
        nav.b_f[i] += dx[_F + i]
        nav.b_w[i] += dx[_W + i]
    for i in range(dx.shape[0] - CORE):
        nav.optional[i] += dx[CORE + i]
    turn, rotated = np.empty((3, 3)), np.empty((3, 3))
    if not c.invariant:
        exponential(turn, rotated, dx[_A], dx[_A + 1], dx[_A + 2])
        product(rotated, turn, nav.C_n_b)
        copy_matrix(nav.C_n_b, rotated)
        orthonormalise(nav.C_n_b, rotated)
        for i in range(3):
            nav.v_n[i] += dx[_V + i]
        if not earth.move(nav.llh, dx[_P : _P + 3]):
            s.counters.beyond_latitude += 1
        return
    heading = np.empty((3, 3))
    about_down(heading, dx[_A + 2])
    exponential(turn, rotated, dx[_A], dx[_A + 1], 0.0)
    product(rotated, turn, nav.C_n_b)
    product(nav.C_n_b, heading, rotated)
    orthonormalise(nav.C_n_b, rotated)
    tilted, before, after = np.empty(3), np.empty(3), np.empty(3)
    rotate(tilted, turn, nav.v_n)
    for i in range(3):
        tilted[i] += dx[_V + i]
    rotate(nav.v_n, heading, tilted)
    earth.displacement(before, nav.llh_r, nav.llh)
    rotate(tilted, turn, before)
    for i in range(3):
        tilted[i] += dx[_P + i]
    rotate(after, heading, tilted)
    for i in range(3):
        after[i] -= before[i]
    if not earth.move(nav.llh, after):
        s.counters.beyond_latitude += 1
    # The errors of velocity, tilt and position are told in the axes of the estimated heading.
    for block in (_V, _A, _P):
        turn_block(nav.P, block, heading, dx.shape[0])
    north, east = nav.bend_n[0], nav.bend_n[1]
    nav.bend_n[0] = heading[0, 0] * north + heading[0, 1] * east
    nav.bend_n[1] = heading[1, 0] * north + heading[1, 1] * east


@kernel
def turn_block(P: Array, block: int, R: Array, n: int) -> None:
    """P (n, n) with the three states from ``block`` on in turned axes, R (3, 3), in place."""
    a, turned = np.empty(3), np.empty(3)
    for j in range(n):
        for i in range(3):
            a[i] = P[block + i, j]
        rotate(turned, R, a)
        for i in range(3):
            P[block + i, j] = turned[i]
    for i in range(n):
        for j in range(3):
            a[j] = P[i, block + j]
        rotate(turned, R, a)
        for j in range(3):
            P[i, block + j] = turned[j]
    for i in range(3):  # the sums of two mirrored elements are rounded in different orders
        for j in range(n):
            P[j, block + i] = P[block + i, j]


@kernel
def remaining(dx: Array) -> Array:
    """Errors of the corrected state by those before, for `invariant`: Jacobian (n, n) of both.

    A tilt that is left turns the correction of velocity and position, and what is left is told in
    the axes of the corrected heading.

    Args:
        dx: (n,) the correction.
    """
    R_h, d_x, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    T = np.eye(len(dx))
    about_down(R_h, dx[_A + 2])
    set_block(T, _A, _A, 1.0, R_h)
    for block in (_V, _P):
        skew(d_x, dx[block : block + 3])
        product(turned, R_h, d_x)
        set_block(T, block, block, 1.0, R_h)
        for i in range(3):
            T[block + i, _A], T[block + i, _A + 1] = turned[i, 0], turned[i, 1]
    return T


def turns_position(s: State, *, invariant: bool) -> Array:
    """[x x] (3, 3) of the position from the reference for `invariant`, zero for `ned`.

    The error of the position in metres is dp = dp_model - [x x] psi.
    """
    return cross_matrix(from_reference(s["nav"])) if invariant else np.zeros((3, 3))


def attitude_error(nav: State, C_n_b: Array, *, invariant: bool) -> Array:
    """Exact error psi (..., 3) of the attitude in the coordinates of the model [rad].

    Args:
        nav: Group ``nav`` of records (...).
        C_n_b: (..., 3, 3) true attitude.
        invariant: Which error state it is.
    """
    turn = C_n_b @ np.swapaxes(nav["C_n_b"], -1, -2)
    if not invariant:
        return vector_from_rotation(turn)
    # The down row of R_h R_t is that of R_t, (-b, a, .) sin|t| / |t| for t = (a, b, 0).
    a, b = turn[..., 2, 1], -turn[..., 2, 0]
    sine = np.hypot(a, b)
    angle = np.arctan2(sine, turn[..., 2, 2])
    scale = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)
    tilt = np.stack([scale * a, scale * b, np.zeros_like(a)], axis=-1)
    R_h = turn @ np.swapaxes(rotation_from_vector(tilt), -1, -2)
    return tilt + np.arctan2(R_h[..., 1, 0], R_h[..., 0, 0])[..., None] * _DOWN


def from_reference(nav: State) -> Array:
    """x (..., 3), the position from the reference [m], of groups ``nav`` of records (...)."""
    return earth.displacements(nav["llh_r"], nav["llh"])


def position_error(nav: State, C_n_b: Array, llh: Array, *, invariant: bool) -> Array:
    """Exact error (..., 3) of the position in the coordinates of the model [m].

    Args:
        nav: Group ``nav`` of records (...).
        C_n_b: (..., 3, 3) true attitude.
        llh: (..., 3) true latitude, longitude [rad] and height [m].
        invariant: Which error state it is.
    """
    error = earth.displacements(nav["llh"], llh)
    if not invariant:
        return error
    x_n = from_reference(nav)
    return _turned_error(nav, C_n_b, x_n + error, x_n)


def velocity_error(nav: State, C_n_b: Array, v_n: Array, *, invariant: bool) -> Array:
    """Exact error (..., 3) of the velocity in the coordinates of the model [m/s].

    Args:
        nav: Group ``nav`` of records (...).
        C_n_b: (..., 3, 3) true attitude.
        v_n: (..., 3) true velocity [m/s].
        invariant: Which error state it is.
    """
    if not invariant:
        return np.asarray(v_n - nav["v_n"])
    return _turned_error(nav, C_n_b, v_n, nav["v_n"])


def _turned_error(nav: State, C_n_b: Array, true: Array, estimate: Array) -> Array:
    """R_h^T a_true - R_t a of vectors (..., 3)."""
    psi = attitude_error(nav, C_n_b, invariant=True)
    heading = psi[..., 2:] * _DOWN
    back = np.einsum("...ji,...j->...i", rotation_from_vector(heading), true)
    tilted = np.einsum("...ij,...j->...i", rotation_from_vector(psi - heading), estimate)
    return np.asarray(back - tilted)


def move_reference(s: State) -> None:
    """Move the reference to where, towards the vehicle, position and heading are independent.

    After a measurement of the position it is no longer the start whose position is known whatever
    the heading is. With r <- r + d, dp_i <- dp_i - [d x] psi to first order; d is that part of x
    which leaves the least variance of dp_i. Where the start is known better than by the
    measurement, the heading is known by then, and d is 0 or turns nothing.
    """
    nav = s["nav"]
    P, x_n = nav["P"], from_reference(nav)
    heading = ATTITUDE.stop - 1
    lever = cross_matrix(x_n)[:, 2]  # what a heading error adds to dp_i, for d = x
    denominator = P[heading, heading] * (lever @ lever)
    if not denominator > 0.0:
        return
    d = float(np.clip(lever @ P[POSITION, heading] / denominator, 0.0, 1.0)) * x_n
    earth.move(nav["llh_r"], d)
    nav["bend_n"] = 0.0
    T = -cross_matrix(d)
    P[POSITION, :] += T @ P[ATTITUDE, :]
    P[:, POSITION] += P[:, ATTITUDE] @ T.T
    P[:] = (P + P.T) / 2


def from_ordinary_errors(
    C_n_b: Array, v_n: Array, x_n: Array, *, invariant: bool, velocity_frame: str, n: int
) -> Array:
    """Jacobian T (n, n) of the model's coordinates with respect to ordinary errors.

    The ordinary errors are (dv, psi, db_f, db_w, dp): the velocity error either in body axes, of
    v_b = C_b_n v_n, or in NED. With P_0 built in them, T P_0 T^T is the filter's covariance.

        dv_ned       = C dv_b - [v x] psi       (body), and then
        dv_invariant = dv_ned + [v x] psi = C dv_b
        dp_invariant = dp_ned + [x x] psi

    Args:
        C_n_b: (3, 3) attitude.
        v_n: (3,) velocity [m/s], NED.
        x_n: (3,) position from the reference [m].
        velocity_frame: ``body`` or ``nav``.
        n: Number of error states.
    """
    T = np.eye(n)
    sign = 0.0
    if velocity_frame == "body":
        T[VELOCITY, VELOCITY] = C_n_b
        sign -= 1.0
    if invariant:
        sign += 1.0
        T[POSITION, ATTITUDE] = cross_matrix(x_n)
    T[VELOCITY, ATTITUDE] = sign * cross_matrix(v_n)
    return T


def body_velocity_jacobian(C_n_b: Array, v_n: Array, *, invariant: bool, n: int) -> Array:
    """Jacobian (..., 3, n) of the body velocity C_b_n v_n: C_b_n dv, and C_b_n [v x] psi for `ned`.

    Args:
        C_n_b: (..., 3, 3) attitude.
        v_n: (..., 3) velocity [m/s], NED.
        n: Number of error states.
    """
    C_b_n = np.swapaxes(C_n_b, -1, -2)
    J = np.zeros((*v_n.shape, n))
    J[..., VELOCITY] = C_b_n
    if not invariant:
        # Row j of the cross product with the unit vectors is column j of [v x].
        v_x = np.swapaxes(np.cross(v_n[..., None, :], np.eye(3)), -1, -2)
        J[..., ATTITUDE] = C_b_n @ v_x
    return J
