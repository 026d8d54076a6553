"""Error state: its map, dynamics, discretisation, injection and initial covariance.

With C_true = exp([psi x]) C, b_true = b + db, and

    ned:        v_true = v + dv
                p_true = p + dp
    invariant:  v_true = exp([psi x]) v + dv           (dv_i = dv_ned + [v x] psi to first order)
                p_true = r + exp([psi x]) x + dp       (dp_i = dp_ned + [x x] psi to first order)

where x = p - r is the position from the reference r, the point whose position was known when the
heading was not: the start. So a correction of the heading turns the path travelled since. Positions
are places on the Earth, and their differences metres north, east and down
(`geometry.earth.displacement`); dp is in those axes at the vehicle.

Behind the fifteen states that every filter has come the blocks of optional states that sensors
bring (measurements/base.py), each a first-order Gauss-Markov process or a constant.

The matrices are derived in docs/explanation/error-state.md, in full and for both.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry import earth
from insdvl.navigation.geometry.rotation import (
    exponential,
    orthonormalise,
    product,
    product_transposed,
    rotate,
    skew,
)
from insdvl.navigation.state import CORE, Constants, State, Workspace

#: State map. The published filter is the first twelve.
VELOCITY = slice(0, 3)  # m/s
ATTITUDE = slice(3, 6)  # rad
ACCELEROMETER_BIAS = slice(6, 9)  # m/s^2
GYROSCOPE_BIAS = slice(9, 12)  # rad/s
POSITION = slice(12, 15)  # m
HORIZONTAL_POSITION = slice(12, 14)

# First elements of the blocks, for the kernels.
_V, _A, _F, _W, _P = 0, 3, 6, 9, 12

# F and Phi are dense in the rows of velocity, attitude and position, and there in the first twelve
# columns; the bias rows of F are zero. Loops over just these blocks skip half of all products.


@kernel
def set_block(F: Array, row: int, column: int, sign: float, M: Array) -> None:
    """F[row:row+3, column:column+3] = sign * M."""
    for i in range(3):
        for j in range(3):
            F[row + i, column + j] = sign * M[i, j]


@kernel
def add_block(F: Array, row: int, column: int, sign: float, M: Array) -> None:
    """F[row:row+3, column:column+3] += sign * M."""
    for i in range(3):
        for j in range(3):
            F[row + i, column + j] += sign * M[i, j]


@kernel
def dynamics(w: Workspace, c: Constants) -> None:
    """F of dx' = F dx + G n into ``w.F``, at the middle of the step that is in the workspace.

    ned (W = 2 w_ie + w_en, W_v = d w_en / d v):
        dv'  = ([v x] W_v - [W x]) dv - [f_n x] psi - C db_f
        psi' = -W_v dv - [w_in x] psi - C db_w
        dp'  = dv
    invariant:
        dv'  = -[W x] dv + ([g x] + [v x][w_ie x]) psi - C db_f - [v x] C db_w
        psi' = -W_v dv + (W_v [v x] - [w_in x]) psi - C db_w
        dp'  = dv + [x x] psi'
    """
    F, C, v_x, x_x, M, N = w.F, w.C_mean, w.v_x, w.x_x, w.a_x, w.block
    skew(v_x, w.v_n)
    for i in range(3):
        w.coriolis[i] = 2.0 * w.w_ie_n[i] + w.w_en_n[i]
    skew(M, w.coriolis)
    set_block(F, _V, _V, -1.0, M)
    set_block(F, _V, _F, -1.0, C)
    set_block(F, _A, _V, -1.0, w.W_v)
    set_block(F, _A, _W, -1.0, C)
    if c.invariant:
        skew(M, w.g_n)
        set_block(F, _V, _A, 1.0, M)
        skew(M, w.w_ie_n)
        product(N, v_x, M)
        add_block(F, _V, _A, 1.0, N)
        product(M, v_x, C)
        set_block(F, _V, _W, -1.0, M)
        product(N, w.W_v, v_x)
        skew(M, w.w_in_n)
        for i in range(3):
            for j in range(3):
                N[i, j] -= M[i, j]
        set_block(F, _A, _A, 1.0, N)
        # The position rows are dv + [x x] times the attitude rows.
        skew(x_x, w.x_n)
        product(M, x_x, N)
        set_block(F, _P, _A, 1.0, M)
        product(M, x_x, w.W_v)
        set_block(F, _P, _V, -1.0, M)
        product(M, x_x, C)
        set_block(F, _P, _W, -1.0, M)
        for i in range(3):
            F[_P + i, _V + i] += 1.0
    else:
        for i in range(3):
            F[_P + i, _V + i] = 1.0
        skew(M, w.w_in_n)
        set_block(F, _A, _A, -1.0, M)
        product(M, v_x, w.W_v)
        add_block(F, _V, _V, 1.0, M)
        skew(M, w.f_n)
        set_block(F, _V, _A, -1.0, M)


@kernel
def discretise(w: Workspace, c: Constants, dt: float) -> None:
    """Phi = I + F dt + (F dt)^2 / 2 into ``w.Phi``; optional states decay exactly."""
    F, Phi = w.F, w.Phi
    for i in range(_F):
        _transition_row(Phi, F, i, dt)
        Phi[i, i] += 1.0
    for i in range(_F, _P):
        Phi[i, i] = 1.0
    for i in range(_P, CORE):
        _transition_row(Phi, F, i, dt)
        Phi[i, i] = 1.0
    for i in range(CORE, c.n):
        Phi[i, i] = np.exp(-c.decay[i - CORE] * dt)
    for i in range(CORE):
        for j in range(CORE):
            w.Phi_T[i, j] = Phi[j, i]


@kernel
def _transition_row(Phi: Array, F: Array, i: int, dt: float) -> None:
    """Row i of F dt + (F dt)^2 / 2; only the velocity and attitude rows of F enter its square."""
    for j in range(_P):
        square = 0.0
        for k in range(_F):
            square += F[i, k] * F[k, j]
        Phi[i, j] = dt * (F[i, j] + 0.5 * dt * square)


@kernel
def input_noise(s: State, w: Workspace, c: Constants, Q_f: Array, Q_w: Array, dt: float) -> None:
    """Q_d = G Q_c G^T dt into ``w.Q_d``, for the densities ``Q_f``, ``Q_w`` (3, 3) and the walks.

    G = [[C, [v x] C, 0, 0], [0, C, 0, 0], [0, 0, I, 0], [0, 0, 0, I], [0, [x x] C, 0, 0]], for
    `ned` without [v x] C and [x x] C. White noise has no sign, so those of G's columns do not
    matter.
    """
    Q_d, C, M, N = w.Q_d, w.C_mean, w.rotated, w.block
    product(M, C, Q_f)
    product_transposed(N, M, C)
    set_block(Q_d, _V, _V, dt, N)
    product(M, C, Q_w)
    product_transposed(N, M, C)
    set_block(Q_d, _A, _A, dt, N)
    if c.invariant:
        skew(w.v_x, w.v_n)
        product(M, w.v_x, N)  # [v x] C Q_w C^T
        for i in range(3):
            for j in range(3):
                Q_d[_V + i, _A + j] = dt * M[i, j]
                Q_d[_A + j, _V + i] = dt * M[i, j]
        skew(w.x_x, w.x_n)
        product(w.a_x, w.x_x, N)  # [x x] C Q_w C^T
        product_transposed(N, M, w.v_x)  # [v x] C Q_w C^T [v x]^T
        add_block(Q_d, _V, _V, dt, N)
        product_transposed(M, w.a_x, w.v_x)  # [x x] C Q_w C^T [v x]^T
        product_transposed(N, w.a_x, w.x_x)  # [x x] C Q_w C^T [x x]^T
        set_block(Q_d, _P, _P, dt, N)
        for i in range(3):
            for j in range(3):
                Q_d[_P + i, _A + j] = dt * w.a_x[i, j]
                Q_d[_A + j, _P + i] = dt * w.a_x[i, j]
                Q_d[_P + i, _V + j] = dt * M[i, j]
                Q_d[_V + j, _P + i] = dt * M[i, j]
    for i in range(3):
        Q_d[_F + i, _F + i] = dt * c.eps_f
        Q_d[_W + i, _W + i] = dt * c.eps_w
    # Halved around the decay by `propagate`, this leaves the stationary variance as it is.
    for i in range(CORE, c.n):
        k = i - CORE
        Q_d[i, i] = 2.0 * c.variance[k] * np.tanh(c.decay[k] * dt)


@kernel
def propagate(P: Array, w: Workspace, n: int) -> None:
    """P <- Phi (P + Q_d / 2) Phi^T + Q_d / 2, in place: second order in the step, symmetric.

    Phi is the identity in the bias rows. So A = Phi (P + Q_d / 2) has the covariance with a bias
    already, and only velocity, attitude and position need the second product, A Phi^T. The
    loops over the fifteen states have a fixed length, which lets the compiler unroll them.
    """
    A, Q_d = w.A, w.Q_d
    for i in range(CORE):
        for j in range(CORE):
            P[i, j] += 0.5 * Q_d[i, j]
    for i in range(_F):
        for j in range(CORE):
            A[i, j] = _combination(w.Phi, i, P, j)
    for i in range(_P, CORE):
        for j in range(CORE):
            A[i, j] = _combination(w.Phi, i, P, j) + P[i, j]

    if n > CORE:
        _propagate_optional(P, w, n)

    for i in range(_F):
        for j in range(i + 1):
            _set_symmetric(P, i, j, _combination(A, i, w.Phi_T, j) + 0.5 * Q_d[i, j])
        for j in range(_F, _P):
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
    for i in range(_P, CORE):
        for j in range(_F):
            _set_symmetric(P, i, j, _combination(A, i, w.Phi_T, j) + 0.5 * Q_d[i, j])
        for j in range(_F, _P):
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
        for j in range(_P, i + 1):
            _set_symmetric(P, i, j, _combination(A, i, w.Phi_T, j) + A[i, j] + 0.5 * Q_d[i, j])
    for i in range(_F, _P):
        for j in range(_F, _P):
            P[i, j] += 0.5 * Q_d[i, j]


@kernel
def _combination(A: Array, i: int, B: Array, j: int) -> float:
    """Sum over k of A[i, k] B[k, j], for k up to the last bias."""
    total = 0.0
    for k in range(_P):
        total += A[i, k] * B[k, j]
    return total


@kernel
def _set_symmetric(P: Array, i: int, j: int, value: float) -> None:
    P[i, j] = value
    P[j, i] = value


@kernel
def _propagate_optional(P: Array, w: Workspace, n: int) -> None:
    """The rows of optional states, which decay by themselves and drive no other state.

    They come before the other rows of P change, since the covariance with those is Phi P decay.
    """
    A, Phi, Q_d = w.A, w.Phi, w.Q_d
    for d in range(CORE, n):
        for i in range(CORE):
            A[i, d] = P[i, d]
            if i < _F:
                A[i, d] = _combination(Phi, i, P, d)
            elif i >= _P:
                A[i, d] += _combination(Phi, i, P, d)
        for i in range(CORE):
            _set_symmetric(P, i, d, A[i, d] * Phi[d, d])
        for e in range(CORE, d + 1):
            value = P[d, e] * Phi[d, d] * Phi[e, e]
            if d == e:
                value += 0.5 * Q_d[d, d] * (1.0 + Phi[d, d] * Phi[d, d])
            _set_symmetric(P, d, e, value)


@kernel
def bend(s: State, w: Workspace, c: Constants, dt: float) -> None:
    """Add to P what a gyroscope bias, which turns the heading while the path grows, makes of it.

    With a heading error h that changes, dp' has a term of second order, h h' x, horizontally. An
    unknown bias b about the vertical makes it so persistent that it adds up, as one sigma, to
    m = int sqrt(E[(h b)^2]) x dt, and E[(h b)^2] = P_hh P_bb + 2 P_hb^2. No velocity tells it: in P
    it stays m m^T until a position is measured.
    """
    nav, P = s.nav, s.nav.P
    heading = _A + 2
    P_bb, P_hb = 0.0, 0.0
    for i in range(3):
        P_hb += P[heading, _W + i] * w.C_mean[2, i]
        for j in range(3):
            P_bb += w.C_mean[2, i] * P[_W + i, _W + j] * w.C_mean[2, j]
    sigma = np.sqrt(max(P[heading, heading] * P_bb + 2.0 * P_hb * P_hb, 0.0))
    for i in range(2):
        for j in range(2):
            P[_P + i, _P + j] -= nav.bend_n[i] * nav.bend_n[j]
    for i in range(2):
        nav.bend_n[i] += dt * sigma * w.x_n[i]
    for i in range(2):
        for j in range(2):
            P[_P + i, _P + j] += nav.bend_n[i] * nav.bend_n[j]


@kernel
def inject(s: State, c: Constants, dx: Array) -> None:
    """Move the nominal state by the error dx (n,), without a reset Jacobian.

    That Jacobian and the curvature of h cancel (docs/explanation/error-state.md).
    """
    nav = s.nav
    for i in range(3):
        nav.b_f[i] += dx[_F + i]
        nav.b_w[i] += dx[_W + i]
    for i in range(dx.shape[0] - CORE):
        nav.optional[i] += dx[CORE + i]
    turn, rotated = np.empty((3, 3)), np.empty((3, 3))
    exponential(turn, rotated, dx[_A], dx[_A + 1], dx[_A + 2])
    product(rotated, turn, nav.C_n_b)
    nav.C_n_b[:] = rotated
    orthonormalise(nav.C_n_b, rotated)
    d_n = dx[_P : _P + 3].copy()
    if c.invariant:
        v_n, x_n, turned = np.empty(3), np.empty(3), np.empty(3)
        rotate(v_n, turn, nav.v_n)
        nav.v_n[:] = v_n
        earth.displacement(x_n, nav.llh_r, nav.llh)
        rotate(turned, turn, x_n)
        for i in range(3):
            d_n[i] += turned[i] - x_n[i]
    for i in range(3):
        nav.v_n[i] += dx[_V + i]
    if not earth.move(nav.llh, d_n):
        s.counters.beyond_latitude += 1


def cross_matrix(a: Array) -> Array:
    """[a x] as a new (3, 3) array."""
    out = np.empty((3, 3))
    skew(out, a)
    return out


def turns_position(s: State, *, invariant: bool) -> Array:
    """[x x] (3, 3) of the position from the reference for `invariant`, zero for `ned`.

    The error of the position in metres is dp = dp_model - [x x] psi.
    """
    return cross_matrix(from_reference(s["nav"])) if invariant else np.zeros((3, 3))


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
    turn = C_n_b @ np.swapaxes(nav["C_n_b"], -1, -2)
    return np.asarray(error + x_n - np.einsum("...ij,...j->...i", turn, x_n))


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
