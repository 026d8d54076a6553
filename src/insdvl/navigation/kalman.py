"""Kalman algebra for a measurement of m rows: innovation covariance, gain, NIS, Joseph form.

What a measurement is, where it comes from and whether it is believed is decided elsewhere
(measurements/, gate.py); here are only the equations, the same for every sensor.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import error_state
from insdvl.navigation.error_state import POSITION
from insdvl.navigation.measurements.base import Linearised

#: An update is iterated while h bends by more than the mean sigma of R, but not for ever: each
#: iteration leaves a fraction.
_BEND = 1.0  # (sigma)^2
#: And a measurement of the position while its H turns by more than this part of R, as the heading
#: that is still unknown sees it.
_TURNED = 0.01
_ITERATIONS = 10
#: Smallest pivot of S, relative to its diagonal: below it the gain would be rounding.
_LEAST_PIVOT = 1e-10


@dataclass(frozen=True)
class Innovated:
    """A measurement against the filter's prediction of it.

    Attributes:
        innovation: (m,) measured minus predicted.
        H: (m, n) Jacobian of the prediction.
        R: (m, m) covariance of the measurement noise.
        S: (m, m) covariance of the innovation, H P H^T + R.
        K: (n, m) gain P H^T S^-1.
        nis: Normalised innovation squared, nu^T S^-1 nu; nan where S is not positive definite.
    """

    innovation: Array
    H: Array
    R: Array
    S: Array
    K: Array
    nis: float


def innovate(P: Array, z_minus_h: Array, H: Array, R: Array) -> Innovated:
    """Compare a measurement with its prediction.

    Args:
        P: (N, N) covariance of the error state, of which the first n are in use.
        z_minus_h: (m,) innovation.
        H: (m, n) Jacobian.
        R: (m, m) covariance of the measurement noise.
    """
    m, n = H.shape
    S, K = np.empty((m, m)), np.empty((n, m))
    nis = _gain(P, H, R, z_minus_h, S, K)
    return Innovated(z_minus_h, H, R, S, K, nis)


@kernel
def _gain(P: Array, H: Array, R: Array, nu: Array, S: Array, K: Array) -> float:
    """S = H P H^T + R and K = P H^T S^-1; returns nu^T S^-1 nu, or nan."""
    m, n = H.shape
    PHt = np.empty((n, m))
    for i in range(n):
        for a in range(m):
            total = 0.0
            for k in range(n):
                total += P[i, k] * H[a, k]
            PHt[i, a] = total
    for a in range(m):
        for b in range(a + 1):
            total = R[a, b]
            for k in range(n):
                total += H[a, k] * PHt[k, b]
            S[a, b] = total
            S[b, a] = total
    S_inv = np.empty((m, m))
    if not _inverse(S, S_inv):
        return np.nan
    for i in range(n):
        for a in range(m):
            total = 0.0
            for b in range(m):
                total += PHt[i, b] * S_inv[b, a]
            K[i, a] = total
    nis = 0.0
    for a in range(m):
        total = 0.0
        for b in range(m):
            total += S_inv[a, b] * nu[b]
        nis += nu[a] * total
    return nis


@kernel
def _inverse(S: Array, S_inv: Array) -> bool:
    """Inverse of a symmetric matrix (m, m) by Cholesky; False where it is not positive definite.

    S = L L^T, and S^-1 = L^-T L^-1. Nor is a matrix whose smallest directions are lost in the
    rounding of the largest.
    """
    m = S.shape[0]
    L, L_inv = np.zeros((m, m)), np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > _LEAST_PIVOT * S[i, i]:  # nan is not
                L[i, i] = np.sqrt(total)
            else:
                return False
    for j in range(m):
        L_inv[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, m):
            total = 0.0
            for k in range(j, i):
                total -= L[i, k] * L_inv[k, j]
            L_inv[i, j] = total / L[i, i]
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, m):
                total += L_inv[k, i] * L_inv[k, j]
            S_inv[i, j] = total
            S_inv[j, i] = total
    return True


@kernel
def _joseph(P: Array, H: Array, K: Array, R: Array) -> None:
    """P <- (I - K H) P (I - K H)^T + K R K^T, in place."""
    m, n = H.shape
    A, B = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for a in range(m):
                total += K[i, a] * H[a, j]
            B[i, j] = (1.0 if i == j else 0.0) - total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += B[i, k] * P[k, j]
            A[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += A[i, k] * B[j, k]
            for a in range(m):
                for b in range(m):
                    total += K[i, a] * R[a, b] * K[j, b]
            P[i, j] = total
            P[j, i] = total


@kernel
def _correct(
    state: Records, constants: Records, H: Array, K: Array, R: Array, innovation: Array
) -> None:
    """Joseph form, then the injection of K nu."""
    n, m = K.shape
    dx = np.empty(n)
    for i in range(n):
        total = 0.0
        for a in range(m):
            total += K[i, a] * innovation[a]
        dx[i] = total
    _joseph(state[0].nav.P, H, K, R)
    error_state.inject(state[0], constants[0], dx)


def correct(
    state: Records,
    constants: Records,
    prior: Innovated,
    relinearise: Callable[[], Linearised],
    *,
    iterate: bool,
) -> tuple[Array, Array]:
    """Correct a state with a measurement, in place.

    After a long outage the correction can be so large that h is not linear over it: the product
    of a tilt and a change of velocity is missed. Where what is left of the innovation is not what
    a linear h leaves, the update is iterated from the same prior with h at the corrected state
    (Gauss-Newton; Bell and Cathey, IEEE Transactions on Automatic Control 38(2), 1993). So it is
    where a measured position moves the state so far that a heading error turns it by more or less.

    Args:
        state: (1,) record.
        constants: (1,) of the filter.
        prior: The measurement at the predicted state.
        relinearise: Linearises the measurement again at the state as it is then.
        iterate: Whether to iterate; the published filter corrects once.

    Returns:
        The gain (n, m) at the prediction, and the innovation (m,) that is left.
    """
    before = state.copy()
    R, n = prior.R, len(prior.K)
    P = before["nav"]["P"][0][:n, :n]
    H, K, innovation = prior.H, prior.K, prior.innovation
    tells_position = iterate and bool(H[:, POSITION].any())
    smallest, corrected, used, left = np.inf, before, (H, K, np.zeros(n)), innovation
    for _ in range(_ITERATIONS):
        dx = K @ innovation
        expected = innovation - H @ dx
        state[:] = before
        _correct(state, constants, H, K, R, innovation)
        again = relinearise()
        bend = again.z_minus_h - expected
        size, turned = bend @ bend / (np.trace(R) / len(R)), 0.0
        if tells_position:
            D = again.H - H @ np.linalg.inv(error_state.remaining(dx))
            turned = np.trace(D @ state["nav"]["P"][0][:n, :n] @ D.T) / np.trace(R)
        if size + turned < smallest:  # should the iteration lead away, the best correction stands
            smallest, corrected, used = size + turned, state.copy(), (H, K, dx)
            left = again.z_minus_h
        converged = size < _BEND and turned < _TURNED
        if converged or not np.isfinite(size) or not iterate:
            break
        H = again.H @ error_state.remaining(dx)
        S = H @ P @ H.T + R
        if not np.linalg.det(S) > 0.0:  # lost in rounding
            break
        K = np.ascontiguousarray(np.linalg.solve(S, H @ P).T)
        innovation = again.z_minus_h + H @ dx
    state[:] = corrected
    H, K, dx = used
    if H is not prior.H:
        # Joseph form with T inside, where large numbers cancel before they are squared.
        T = error_state.remaining(dx)
        A, B = T @ (np.eye(n) - K @ H), T @ K
        P = A @ P @ A.T + B @ R @ B.T
        state["nav"]["P"][0][:n, :n] = (P + P.T) / 2
    return K, left
