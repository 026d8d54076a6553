"""Error state: its map, dynamics, noise and discretisation.

What the errors are is in coordinates.py. Behind the fifteen states that every filter has come the
blocks of optional states that sensors bring (measurements/base.py), each a first-order Gauss-Markov
process or a constant.

The matrices are derived in docs/explanation/error-state.md, in full and for both.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.earth import earth_rate_n
from insdvl.navigation.geometry.rotation import (
    product,
    product_transposed,
    skew,
)
from insdvl.navigation.state.fields import CORE, PADDED, State
from insdvl.navigation.state.scratch import Constants, Workspace

#: State map. The published filter is the first twelve.
VELOCITY = slice(0, 3)  # m/s
ATTITUDE = slice(3, 6)  # rad
ACCELEROMETER_BIAS = slice(6, 9)  # m/s^2
GYROSCOPE_BIAS = slice(9, 12)  # rad/s
POSITION = slice(12, 15)  # m
HORIZONTAL_POSITION = slice(12, 14)

# First elements of the blocks, for the kernels.
_V, _A, _F, _W, _P = 0, 3, 6, 9, 12

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
def heading_moments(variance: float) -> tuple[float, float, float]:
    """How sine and cosine of a normal heading error h of that variance go along with it.

    From E[cos h] = exp(-variance / 2) and E[cos 2h] = exp(-2 variance).

    Returns:
        The slope of the best line through sin h, E[h sin h] / variance; the second moment of what
        that line leaves of sin h; and that of 1 - cos h.
    """
    one, two = np.exp(-0.5 * variance), np.exp(-2.0 * variance)
    of_sine = 0.5 * (1.0 - two) - one * one * variance
    of_cosine = 1.0 - 2.0 * one + 0.5 * (1.0 + two)
    return one, max(of_sine, 0.0), max(of_cosine, 0.0)  # rounding may leave less than nothing


@kernel
def earth_rate_seen(s: State, w: Workspace) -> None:
    """What an uncertain heading h lets be known of the Earth's rotation, into the workspace.

    In the axes of the estimated heading it is off by w_N (cos h - 1) north and -w_N sin h east.
    F has the slope of the best line through sin h (`heading_moments`). The rest of both is an
    unknown rate r that stays while h does, and over the time T since the start makes a tilt of
    variance (r T)^2, as a density 2 r^2 T does. A bias that is as unknown covers it.
    """
    P = s.nav.P
    w.heading_slope, of_sine, of_cosine = heading_moments(P[_A + 2, _A + 2])
    bias = (P[_W, _W] + P[_W + 1, _W + 1] + P[_W + 2, _W + 2]) / 3.0
    twice = 2e-9 * (s.nav.time_ns - s.nav.start_ns)
    north, east = of_cosine * w.w_ie_n[0] ** 2, of_sine * w.w_ie_n[0] ** 2
    w.heading_rest[0] = twice * north * north / (north + bias) if north > 0.0 else 0.0
    w.heading_rest[1] = twice * east * east / (east + bias) if east > 0.0 else 0.0


def take_earth_rate_from_bias(s: State, before: float, bias: float) -> None:
    """A heading has been told: what the gyroscope bias has covered for it is now in P.

    While the heading is uncertain, what is estimated is the sum of the bias and of the unknown rate
    r of `earth_rate_seen`, and P is that of the sum. r becomes known with the heading, and the bias
    is what is left: as uncertain as both, where it could cover r at all.

    Args:
        s: State, corrected by the heading.
        before: Variance of the heading before that [rad^2].
        bias: Variance of each axis of the gyroscope bias at the start [(rad/s)^2].
    """
    P, C, w_ie_n = s["nav"]["P"], s["nav"]["C_n_b"], np.empty(3)
    earth_rate_n(s["nav"]["llh"][0], w_ie_n)
    _, *old = heading_moments(before)
    _, *new = heading_moments(P[_A + 2, _A + 2])
    sine, cosine = (max(a - b, 0.0) * w_ie_n[0] ** 2 for a, b in zip(old, new, strict=True))
    rates = np.array([cosine, sine, 0.0])  # squares, north, east, down
    covered = rates * bias / (rates + bias) if bias > 0.0 else 0.0 * rates
    added = C.T @ (covered[:, None] * C)
    P[_W : _W + 3, _W : _W + 3] += (added + added.T) / 2.0


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
    Phi, Phi_T = w.Phi, w.Phi_T
    for i in range(_F):
        _transition_row(w, i, dt)
        Phi[i, i] += 1.0
    for i in range(_F, _P):
        Phi[i, i] = 1.0
    for i in range(_P, CORE):
        _transition_row(w, i, dt)
        Phi[i, i] = 1.0
    for i in range(CORE, c.n):
        Phi[i, i] = np.exp(-c.decay[i - CORE] * dt)
    for j in range(_P):  # the columns of the biases are not needed
        for i in range(_F):
            Phi_T[j, i] = Phi[i, j]
        for i in range(_P, CORE):
            Phi_T[j, i] = Phi[i, j]


@kernel
def _transition_row(w: Workspace, i: int, dt: float) -> None:
    """Row i of F dt + (F dt)^2 / 2; only the velocity and attitude rows of F enter its square."""
    F, Phi = w.F, w.Phi
    f_0, f_1, f_2, f_3, f_4, f_5 = F[i, 0], F[i, 1], F[i, 2], F[i, 3], F[i, 4], F[i, 5]
    for j in range(PADDED):
        square = (
            f_0 * F[0, j]
            + f_1 * F[1, j]
            + f_2 * F[2, j]
            + f_3 * F[3, j]
            + f_4 * F[4, j]
            + f_5 * F[5, j]
        )
        Phi[i, j] = dt * (F[i, j] + 0.5 * dt * square)


@kernel
def transition(s: State, w: Workspace, c: Constants, dt: float) -> None:
    """Phi of the step that is in the workspace into ``w.Phi``; the optional states decay by it."""
    if c.invariant:
        earth_rate_seen(s, w)
    dynamics(w, c)
    discretise(w, c, dt)
    for i in range(CORE, c.n):
        s.nav.optional[i - CORE] *= w.Phi[i, i]


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

    Phi is the identity in the bias rows. So A = Phi B, B = P + Q_d / 2, has the covariance with a
    bias already, and only velocity, attitude and position need the second product, A Phi^T. All
    matrices of the products are in the workspace: there the compiler knows where their rows are.
    """
    A, B, Q_d = w.A, w.B, w.Q_d
    for i in range(CORE):
        for j in range(PADDED):
            B[i, j] = P[i, j] + 0.5 * Q_d[i, j]
    for i in range(_F):
        _row_of_first(w, i)
    for i in range(_P, CORE):
        _row_of_first(w, i)
        for j in range(PADDED):
            A[i, j] += B[i, j]

    if n > CORE:
        _propagate_optional(P, w, n)

    for i in range(_F, _P):
        for j in range(_F, _P):
            P[i, j] = B[i, j] + 0.5 * Q_d[i, j]
    for i in range(_F):
        _row_of_second(w, i)
        for j in range(i + 1):
            _set_symmetric(P, i, j, B[i, j] + 0.5 * Q_d[i, j])
        for j in range(_F, _P):
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
    for i in range(_P, CORE):
        _row_of_second(w, i)
        for j in range(_F):
            _set_symmetric(P, i, j, B[i, j] + 0.5 * Q_d[i, j])
        for j in range(_F, _P):
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
        for j in range(_P, i + 1):
            _set_symmetric(P, i, j, B[i, j] + A[i, j] + 0.5 * Q_d[i, j])


# The twelve coefficients of a row are read once, and a row has whole registers of the processor.


@kernel
def _row_of_first(w: Workspace, i: int) -> None:
    """A[i] = sum over k of Phi[i, k] B[k], for k up to the last bias."""
    A, B, Phi = w.A, w.B, w.Phi
    c_0, c_1, c_2, c_3, c_4, c_5 = Phi[i, 0], Phi[i, 1], Phi[i, 2], Phi[i, 3], Phi[i, 4], Phi[i, 5]
    c_6, c_7, c_8, c_9, c_10, c_11 = (
        Phi[i, 6],
        Phi[i, 7],
        Phi[i, 8],
        Phi[i, 9],
        Phi[i, 10],
        Phi[i, 11],
    )
    for j in range(PADDED):
        A[i, j] = (
            c_0 * B[0, j]
            + c_1 * B[1, j]
            + c_2 * B[2, j]
            + c_3 * B[3, j]
            + c_4 * B[4, j]
            + c_5 * B[5, j]
            + c_6 * B[6, j]
            + c_7 * B[7, j]
            + c_8 * B[8, j]
            + c_9 * B[9, j]
            + c_10 * B[10, j]
            + c_11 * B[11, j]
        )


@kernel
def _row_of_second(w: Workspace, i: int) -> None:
    """B[i] = sum over k of A[i, k] Phi_T[k], for k up to the last bias."""
    A, B, Phi_T = w.A, w.B, w.Phi_T
    c_0, c_1, c_2, c_3, c_4, c_5 = A[i, 0], A[i, 1], A[i, 2], A[i, 3], A[i, 4], A[i, 5]
    c_6, c_7, c_8, c_9, c_10, c_11 = A[i, 6], A[i, 7], A[i, 8], A[i, 9], A[i, 10], A[i, 11]
    for j in range(PADDED):
        B[i, j] = (
            c_0 * Phi_T[0, j]
            + c_1 * Phi_T[1, j]
            + c_2 * Phi_T[2, j]
            + c_3 * Phi_T[3, j]
            + c_4 * Phi_T[4, j]
            + c_5 * Phi_T[5, j]
            + c_6 * Phi_T[6, j]
            + c_7 * Phi_T[7, j]
            + c_8 * Phi_T[8, j]
            + c_9 * Phi_T[9, j]
            + c_10 * Phi_T[10, j]
            + c_11 * Phi_T[11, j]
        )


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
