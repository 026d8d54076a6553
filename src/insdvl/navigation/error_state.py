"""Error state: its map, dynamics, discretisation, DVL Jacobian, injection and initial covariance.

With C_true = exp([psi x]) C, b_true = b + db, p_true = p + dp, and

    ned:        v_true = v + dv
    invariant:  v_true = exp([psi x]) v + dv     (dv_i = dv_ned + [v_n x] psi to first order)

The matrices are derived in docs/error-state.md, in full and for both.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.kernels import kernel
from insdvl.navigation.geometry.rotation import (
    cross,
    exponential,
    orthonormalise,
    product,
    product_transposed,
    rotate,
    rotate_back,
    skew,
)
from insdvl.navigation.state import Constants, State, Workspace
from insdvl.navigation.strapdown import turn_rate

Array = NDArray[np.float64]

#: State map. The published filter is the first twelve.
VELOCITY = slice(0, 3)  # m/s
ATTITUDE = slice(3, 6)  # rad
ACCELEROMETER_BIAS = slice(6, 9)  # m/s^2
GYROSCOPE_BIAS = slice(9, 12)  # rad/s
POSITION = slice(12, 15)  # m
DVL_ERROR = slice(15, 18)  # m/s, only with dvl.bias_model

# First elements of the blocks, for the kernels.
_V, _A, _F, _W, _P, _D = 0, 3, 6, 9, 12, 15

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
        dp'  = dv - [v x] psi
    """
    F, C, v_x, M, N = w.F, w.C_mean, w.M1, w.M2, w.M3
    skew(v_x, w.v_n)
    for i in range(3):
        w.x1[i] = 2.0 * w.w_ie_n[i] + w.w_en_n[i]
    skew(M, w.x1)
    set_block(F, _V, _V, -1.0, M)
    set_block(F, _V, _F, -1.0, C)
    set_block(F, _A, _V, -1.0, w.W_v)
    skew(M, w.w_in_n)
    set_block(F, _A, _A, -1.0, M)
    set_block(F, _A, _W, -1.0, C)
    for i in range(3):
        F[_P + i, _V + i] = 1.0
    if c.invariant:
        skew(M, w.g_n)
        set_block(F, _V, _A, 1.0, M)
        skew(M, w.w_ie_n)
        product(N, v_x, M)
        add_block(F, _V, _A, 1.0, N)
        product(M, v_x, C)
        set_block(F, _V, _W, -1.0, M)
        product(M, w.W_v, v_x)
        add_block(F, _A, _A, 1.0, M)
        set_block(F, _P, _A, -1.0, v_x)
    else:
        product(M, v_x, w.W_v)
        add_block(F, _V, _V, 1.0, M)
        skew(M, w.f_n)
        set_block(F, _V, _A, -1.0, M)


@kernel
def discretise(w: Workspace, c: Constants, dt: float) -> None:
    """Phi = I + F dt + (F dt)^2 / 2 into ``w.Phi``; the DVL error decays exactly."""
    F, Phi = w.F, w.Phi
    for i in range(_F):
        _transition_row(Phi, F, i, dt)
        Phi[i, i] += 1.0
    for i in range(_F, _P):
        Phi[i, i] = 1.0
    for i in range(_P, _D):
        _transition_row(Phi, F, i, dt)
        Phi[i, i] = 1.0
    for i in range(_D, F.shape[0]):
        Phi[i, i] = np.exp(-c.bias_rate * dt)
    for i in range(F.shape[0]):
        for j in range(F.shape[0]):
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

    G = [[C, [v x] C (invariant) or 0, 0, 0], [0, C, 0, 0], [0, 0, I, 0], [0, 0, 0, I], [0]]. White
    noise has no sign, so those of G's columns do not matter.
    """
    Q_d, C, M, N = w.Q_d, w.C_mean, w.M1, w.M2
    n = Q_d.shape[0]
    product(M, C, Q_f)
    product_transposed(N, M, C)
    set_block(Q_d, _V, _V, dt, N)
    product(M, C, Q_w)
    product_transposed(N, M, C)
    set_block(Q_d, _A, _A, dt, N)
    if c.invariant:
        skew(w.M3, w.v_n)
        product(M, w.M3, N)  # [v x] C Q_w C^T
        for i in range(3):
            for j in range(3):
                Q_d[_V + i, _A + j] = dt * M[i, j]
                Q_d[_A + j, _V + i] = dt * M[i, j]
        product_transposed(N, M, w.M3)  # [v x] C Q_w C^T [v x]^T
        add_block(Q_d, _V, _V, dt, N)
    for i in range(3):
        Q_d[_F + i, _F + i] = dt * c.eps_f
        Q_d[_W + i, _W + i] = dt * c.eps_w
    # Halved around the decay by `propagate`, this leaves the stationary variance as it is.
    for i in range(_D, n):
        Q_d[i, i] = 2.0 * c.bias_variance * np.tanh(c.bias_rate * dt)


@kernel
def propagate(P: Array, w: Workspace) -> None:
    """P <- Phi (P + Q_d / 2) Phi^T + Q_d / 2, in place: second order in the step, symmetric.

    Phi is the identity in the bias rows. So A = Phi (P + Q_d / 2) has the covariance with a bias
    already, and only velocity, attitude and position need the second product, A Phi^T. The
    loops over the fifteen states have a fixed length, which lets the compiler unroll them.
    """
    A, Q_d = w.A, w.Q_d
    for i in range(_D):
        for j in range(_D):
            P[i, j] += 0.5 * Q_d[i, j]
    for i in range(_F):
        for j in range(_D):
            A[i, j] = _combination(w.Phi, i, P, j)
    for i in range(_P, _D):
        for j in range(_D):
            A[i, j] = _combination(w.Phi, i, P, j) + P[i, j]

    if P.shape[0] > _D:
        _propagate_dvl_error(P, w)

    for i in range(_F):
        for j in range(i + 1):
            _set_symmetric(P, i, j, _combination(A, i, w.Phi_T, j) + 0.5 * Q_d[i, j])
        for j in range(_F, _P):
            _set_symmetric(P, i, j, A[i, j] + 0.5 * Q_d[i, j])
    for i in range(_P, _D):
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
def _propagate_dvl_error(P: Array, w: Workspace) -> None:
    """The rows of the DVL error, which decays by itself and drives no other state.

    It comes before the other rows of P change, since its covariance with them is Phi P decay.
    """
    A, Phi, Q_d = w.A, w.Phi, w.Q_d
    for d in range(_D, P.shape[0]):
        for i in range(_D):
            A[i, d] = P[i, d]
            if i < _F:
                A[i, d] = _combination(Phi, i, P, d)
            elif i >= _P:
                A[i, d] += _combination(Phi, i, P, d)
        for i in range(_D):
            _set_symmetric(P, i, d, A[i, d] * Phi[d, d])
        for e in range(_D, d + 1):
            value = P[d, e] * Phi[d, d] * Phi[e, e]
            if d == e:
                value += 0.5 * Q_d[d, d] * (1.0 + Phi[d, d] * Phi[d, d])
            _set_symmetric(P, d, e, value)


@kernel
def dvl_measurement(s: State, w: Workspace, c: Constants, v_d: Array, w_ib_b: Array) -> None:
    """Innovation v_d - h and the Jacobian H of h into the workspace.

    h = C_d_b (C_b_n v_n + w_nb_b x l) + b_d,  w_nb_b = w_ib_b - b_w - C_b_n w_in_n

    H = C_d_b [ C_b_n | C_b_n [v x] (ned) or 0 (invariant) | 0 | [l x] | 0 ] + [ 0 ... | I ],
    and [l x] C_b_n [w_in x] in the attitude column, from the Earth rate in w_nb.

    Args:
        v_d: (3,) measured velocity [m/s], DVL axes.
        w_ib_b: (3,) measured angular rate [rad/s], base_link axes.
    """
    H, l_x, M, N = w.H, w.M1, w.M2, w.M3
    n = H.shape[1]
    w_nb, v_b, v_l = w.x1, w.x2, w.x3
    for i in range(3):
        w.x2[i] = w_ib_b[i] - s.b_w[i]
    turn_rate(w_nb, s, w, c, w.x2)
    rotate_back(v_b, s.C_n_b, s.v_n)
    cross(v_l, w_nb, c.l_b)
    for i in range(3):
        v_l[i] += v_b[i]
    rotate(w.x4, c.C_d_b, v_l)
    for i in range(3):
        w.innovation[i] = v_d[i] - w.x4[i]

    H[:] = 0.0
    product_transposed(M, c.C_d_b, s.C_n_b)
    set_block(H, 0, _V, 1.0, M)
    skew(l_x, c.l_b)
    product(N, c.C_d_b, l_x)
    set_block(H, 0, _W, 1.0, N)
    product_transposed(M, N, s.C_n_b)
    skew(l_x, w.w_in_n)
    product(N, M, l_x)
    set_block(H, 0, _A, 1.0, N)
    if not c.invariant:
        product_transposed(M, c.C_d_b, s.C_n_b)
        skew(l_x, s.v_n)
        product(N, M, l_x)
        add_block(H, 0, _A, 1.0, N)
    if n > _D:
        for i in range(3):
            H[i, _D + i] = 1.0
            w.innovation[i] -= s.b_d[i]


@kernel
def innovation_covariance(P: Array, w: Workspace, R: Array) -> float:
    """S = H P H^T + R, its inverse and the gain K = P H^T S^-1 into the workspace.

    Returns:
        The normalised innovation squared nu^T S^-1 nu; nan where S is not positive definite.
    """
    n = P.shape[0]
    H, S, S_inv, K = w.H, w.S, w.S_inv, w.K
    PHt = w.A  # its first three columns
    for i in range(n):
        for a in range(3):
            total = 0.0
            for k in range(n):
                total += P[i, k] * H[a, k]
            PHt[i, a] = total
    for a in range(3):
        for b in range(a + 1):
            total = R[a, b]
            for k in range(n):
                total += H[a, k] * PHt[k, b]
            S[a, b] = total
            S[b, a] = total
    minor = S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            b, d = (a + 1) % 3, (a + 2) % 3
            S_inv[i, a] = S[j, b] * S[k, d] - S[j, d] * S[k, b]
    determinant = S[0, 0] * S_inv[0, 0] + S[0, 1] * S_inv[0, 1] + S[0, 2] * S_inv[0, 2]
    if not (S[0, 0] > 0.0 and minor > 0.0 and determinant > 0.0):
        return np.nan
    for i in range(3):
        for a in range(3):
            S_inv[i, a] /= determinant
    for i in range(n):
        for a in range(3):
            K[i, a] = PHt[i, 0] * S_inv[0, a] + PHt[i, 1] * S_inv[1, a] + PHt[i, 2] * S_inv[2, a]
    rotate(w.x1, S_inv, w.innovation)
    return w.innovation[0] * w.x1[0] + w.innovation[1] * w.x1[1] + w.innovation[2] * w.x1[2]


@kernel
def correct(s: State, w: Workspace, c: Constants, R: Array) -> None:
    """Apply the innovation and the gain of the workspace to the state and its covariance.

    Joseph form, P <- (I - K H) P (I - K H)^T + K R K^T, and no reset Jacobian afterwards: it and
    the curvature of h cancel (docs/error-state.md).
    """
    n = s.P.shape[0]
    A, B, H, K = w.A, w.B, w.H, w.K
    for i in range(n):
        for j in range(n):
            B[i, j] = (1.0 if i == j else 0.0) - (
                K[i, 0] * H[0, j] + K[i, 1] * H[1, j] + K[i, 2] * H[2, j]
            )
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += B[i, k] * s.P[k, j]
            A[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += A[i, k] * B[j, k]
            for a in range(3):
                for b in range(3):
                    total += K[i, a] * R[a, b] * K[j, b]
            s.P[i, j] = total
            s.P[j, i] = total
    inject(s, w, c)


@kernel
def inject(s: State, w: Workspace, c: Constants) -> None:
    """Move the nominal state by the error dx = K innovation."""
    K, nu = w.K, w.innovation
    dv, psi = w.x1, w.x2
    for i in range(3):
        dv[i] = K[_V + i, 0] * nu[0] + K[_V + i, 1] * nu[1] + K[_V + i, 2] * nu[2]
        psi[i] = K[_A + i, 0] * nu[0] + K[_A + i, 1] * nu[1] + K[_A + i, 2] * nu[2]
        s.b_f[i] += K[_F + i, 0] * nu[0] + K[_F + i, 1] * nu[1] + K[_F + i, 2] * nu[2]
        s.b_w[i] += K[_W + i, 0] * nu[0] + K[_W + i, 1] * nu[1] + K[_W + i, 2] * nu[2]
        s.p_n[i] += K[_P + i, 0] * nu[0] + K[_P + i, 1] * nu[1] + K[_P + i, 2] * nu[2]
    if K.shape[0] > _D:
        for i in range(3):
            s.b_d[i] += K[_D + i, 0] * nu[0] + K[_D + i, 1] * nu[1] + K[_D + i, 2] * nu[2]
    turn = w.M1
    exponential(turn, w.M2, psi[0], psi[1], psi[2])
    product(w.M3, turn, s.C_n_b)
    s.C_n_b[:] = w.M3
    orthonormalise(s.C_n_b, w.M2)
    if c.invariant:
        rotate(w.x3, turn, s.v_n)
        s.v_n[:] = w.x3
    for i in range(3):
        s.v_n[i] += dv[i]


def cross_matrix(a: Array) -> Array:
    """[a x] as a new (3, 3) array."""
    out = np.empty((3, 3))
    skew(out, a)
    return out


def from_ordinary_errors(
    C_n_b: Array, v_n: Array, *, invariant: bool, velocity_frame: str, n: int
) -> Array:
    """Jacobian T (n, n) of the model's coordinates with respect to ordinary errors.

    The ordinary errors are (dv, psi, db_f, db_w, dp): the velocity error either in body axes, of
    v_b = C_b_n v_n, or in NED. With P_0 built in them, T P_0 T^T is the filter's covariance.

        dv_ned       = C dv_b - [v x] psi       (body), and then
        dv_invariant = dv_ned + [v x] psi = C dv_b

    Args:
        C_n_b: (3, 3) attitude.
        v_n: (3,) velocity [m/s], NED.
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
