"""Error state: its map, dynamics, discretisation, injection and initial covariance.

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

Behind the fifteen states that every filter has come the blocks of optional states that sensors
bring (measurements/base.py), each a first-order Gauss-Markov process or a constant.

The matrices are derived in docs/explanation/error-state.md, in full and for both.
"""

import numpy as np
from scipy.spatial.transform import Rotation

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

_DOWN = np.array([0.0, 0.0, 1.0])
_ROOT_3 = np.sqrt(3.0)

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
def earth_rate_seen(s: State, w: Workspace) -> None:
    """What an uncertain heading h lets be known of the Earth's rotation, into the workspace.

    In the axes of the estimated heading it is off by w_N (cos h - 1) north and -w_N sin h east.
    For a normal h the best line through sin h has the slope exp(-variance / 2). The rest of both is
    an unknown rate r that stays while h does, and over the time T since the start makes a tilt of
    variance (r T)^2, as a density 2 r^2 T does. A bias that is as unknown covers it.
    """
    P = s.nav.P
    variance = P[_A + 2, _A + 2]
    one, two = np.exp(-0.5 * variance), np.exp(-2.0 * variance)
    w.heading_slope = one
    bias = (P[_W, _W] + P[_W + 1, _W + 1] + P[_W + 2, _W + 2]) / 3.0
    twice = 2e-9 * (s.nav.time_ns - s.nav.start_ns)
    north = max(1.0 - 2.0 * one + 0.5 * (1.0 + two), 0.0) * w.w_ie_n[0] ** 2
    east = max(0.5 * (1.0 - two) - one * one * variance, 0.0) * w.w_ie_n[0] ** 2
    w.heading_rest[0] = twice * north * north / (north + bias) if north > 0.0 else 0.0
    w.heading_rest[1] = twice * east * east / (east + bias) if east > 0.0 else 0.0


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

    The heading column of [w_ie x] has the slope of `earth_rate_seen`.
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
        M[1, 2] *= w.heading_slope
        product(N, v_x, M)
        add_block(F, _V, _A, 1.0, N)
        product(M, v_x, C)
        set_block(F, _V, _W, -1.0, M)
        product(N, w.W_v, v_x)
        skew(M, w.w_in_n)
        for i in range(3):
            for j in range(3):
                N[i, j] -= M[i, j]
        N[1, 2] -= (1.0 - w.heading_slope) * w.w_ie_n[0]
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
    matter. For `invariant` the rest of `earth_rate_seen` is added to the noise of the gyroscope.
    """
    Q_d, C, M, N = w.Q_d, w.C_mean, w.rotated, w.block
    product(M, C, Q_f)
    product_transposed(N, M, C)
    set_block(Q_d, _V, _V, dt, N)
    product(M, C, Q_w)
    product_transposed(N, M, C)
    if c.invariant:
        for i in range(2):
            N[i, i] += w.heading_rest[i]
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
def bend(s: State, w: Workspace, dt: float) -> None:
    """Add to P what a gyroscope bias, which turns the heading while the path grows, makes of it.

    With a heading error that changes, dp' has a term of second order, -h' e_D x dp, horizontally.
    An unknown bias about the vertical, h' = -b, and the dp that it has made are one random number z
    times their sigmas: the term is z^2 e_D x P_pb, and adds up, since z stays. One sigma of it is
    m = sqrt(E[z^4]) int e_D x P_pb dt. No velocity tells it: in P it stays m m^T until a position
    is measured.
    """
    nav, P = s.nav, s.nav.P
    P_pb = np.zeros(2)
    for i in range(2):
        for j in range(3):
            P_pb[i] += P[_P + i, _W + j] * w.C_mean[2, j]
    for i in range(2):
        for j in range(2):
            P[_P + i, _P + j] -= nav.bend_n[i] * nav.bend_n[j]
    nav.bend_n[0] -= _ROOT_3 * P_pb[1] * dt
    nav.bend_n[1] += _ROOT_3 * P_pb[0] * dt
    for i in range(2):
        for j in range(2):
            P[_P + i, _P + j] += nav.bend_n[i] * nav.bend_n[j]


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
        nav.C_n_b[:] = rotated
        orthonormalise(nav.C_n_b, rotated)
        for i in range(3):
            nav.v_n[i] += dx[_V + i]
        if not earth.move(nav.llh, dx[_P : _P + 3]):
            s.counters.beyond_latitude += 1
        return
    tilted, before, after = np.empty(3), np.empty(3), np.empty(3)
    exponential(turn, rotated, dx[_A], dx[_A + 1], 0.0)
    product(rotated, turn, nav.C_n_b)
    cos, sin = np.cos(dx[_A + 2]), np.sin(dx[_A + 2])
    for j in range(3):
        nav.C_n_b[0, j] = cos * rotated[0, j] - sin * rotated[1, j]
        nav.C_n_b[1, j] = sin * rotated[0, j] + cos * rotated[1, j]
        nav.C_n_b[2, j] = rotated[2, j]
    orthonormalise(nav.C_n_b, rotated)
    rotate(tilted, turn, nav.v_n)
    for i in range(3):
        tilted[i] += dx[_V + i]
    _turn_about_down(nav.v_n, tilted, cos, sin)
    earth.displacement(before, nav.llh_r, nav.llh)
    rotate(tilted, turn, before)
    for i in range(3):
        tilted[i] += dx[_P + i]
    _turn_about_down(after, tilted, cos, sin)
    for i in range(3):
        after[i] -= before[i]
    if not earth.move(nav.llh, after):
        s.counters.beyond_latitude += 1
    turn_axes(nav.P, cos, sin)
    north, east = nav.bend_n[0], nav.bend_n[1]
    nav.bend_n[0] = cos * north - sin * east
    nav.bend_n[1] = sin * north + cos * east


@kernel
def _turn_about_down(out: Array, a: Array, cos: float, sin: float) -> None:
    """out = R_h a; `out` is not a."""
    out[0] = cos * a[0] - sin * a[1]
    out[1] = sin * a[0] + cos * a[1]
    out[2] = a[2]


@kernel
def turn_axes(P: Array, cos: float, sin: float) -> None:
    """P (N, N) of `invariant` in the axes of a heading that was turned by an angle, in place.

    The errors of velocity, tilt and position are told in the axes of the estimated heading.
    """
    n = P.shape[0]
    for a in (_V, _A, _P):
        for j in range(n):
            north, east = P[a, j], P[a + 1, j]
            P[a, j] = cos * north - sin * east
            P[a + 1, j] = sin * north + cos * east
    for a in (_V, _A, _P):
        for i in range(n):
            north, east = P[i, a], P[i, a + 1]
            P[i, a] = cos * north - sin * east
            P[i, a + 1] = sin * north + cos * east


def remaining(dx: Array) -> Array:
    """Errors of the corrected state by those before, for `invariant`: Jacobian (n, n) of both.

    A tilt that is left turns the correction of velocity and position, and what is left is told in
    the axes of the corrected heading.

    Args:
        dx: (n,) the correction.
    """
    cos, sin = np.cos(dx[_A + 2]), np.sin(dx[_A + 2])
    R_h = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    T = np.eye(len(dx))
    T[ATTITUDE, ATTITUDE] = R_h
    for block in (VELOCITY, POSITION):
        T[block, block] = R_h
        T[block, _A : _A + 2] = (R_h @ cross_matrix(dx[block]))[:, :2]
    return T


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


def attitude_error(nav: State, C_n_b: Array, *, invariant: bool) -> Array:
    """Exact error psi (..., 3) of the attitude in the coordinates of the model [rad].

    Args:
        nav: Group ``nav`` of records (...).
        C_n_b: (..., 3, 3) true attitude.
        invariant: Which error state it is.
    """
    turn = C_n_b @ np.swapaxes(nav["C_n_b"], -1, -2)
    if not invariant:
        return Rotation.from_matrix(turn).as_rotvec()
    # The down row of R_h R_t is that of R_t, (-b, a, .) sin|t| / |t| for t = (a, b, 0).
    a, b = turn[..., 2, 1], -turn[..., 2, 0]
    sine = np.hypot(a, b)
    angle = np.arctan2(sine, turn[..., 2, 2])
    scale = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)
    tilt = np.stack([scale * a, scale * b, np.zeros_like(a)], axis=-1)
    R_h = turn @ np.swapaxes(_rotations(tilt), -1, -2)
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
    back = np.einsum("...ji,...j->...i", _rotations(heading), true)
    return np.asarray(back - np.einsum("...ij,...j->...i", _rotations(psi - heading), estimate))


def _rotations(psi: Array) -> Array:
    """exp([psi x]) (..., 3, 3) of rotation vectors (..., 3)."""
    return Rotation.from_rotvec(psi.reshape(-1, 3)).as_matrix().reshape(*psi.shape, 3)


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
