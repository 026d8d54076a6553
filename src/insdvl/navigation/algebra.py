"""Matrices of the Kalman filter for a measurement of m rows: gain, NIS, Joseph form, in kernels."""

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel

#: Smallest pivot of S, relative to its diagonal: below it the gain would be rounding.
_LEAST_PIVOT = 1e-10


@kernel
def is_measured(H: Array, a: int) -> bool:
    """Whether row a of a Jacobian (m, n) is not one of zeros."""
    count = 0
    for i in range(H.shape[1]):
        count += H[a, i] != 0.0
    return count > 0


@kernel
def rows_of(H: Array) -> int:
    """Number of components that were measured, by the Jacobian (m, n)."""
    rows = 0
    for a in range(H.shape[0]):
        rows += is_measured(H, a)
    return rows


@kernel
def tells(H: Array, first: int, last: int) -> bool:
    """Whether a Jacobian (m, n) has any of the error states first <= i < last."""
    for a in range(H.shape[0]):
        for i in range(first, last):
            if H[a, i] != 0.0:
                return True
    return False


@kernel
def gain(P: Array, H: Array, R: Array, nu: Array, S: Array, K: Array) -> float:
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
def remainder(K: Array, H: Array) -> Array:
    """I - K H (n, n)."""
    n = len(K)
    B, row = np.eye(n), np.empty(n)
    for i in range(n):
        row[:] = 0.0
        for a in range(len(H)):
            k = K[i, a]
            for j in range(n):
                row[j] += k * H[a, j]
        for j in range(n):
            B[i, j] -= row[j]
    return B


@kernel
def joseph(P: Array, P_0: Array, B: Array, K: Array, R: Array, workspace: Records) -> None:
    """P = B P_0 B^T + K R K^T, symmetric; P may be P_0.

    Most columns of B are those of the identity: the measurement has nothing of these states. The
    products go from row to row and leave them out, which changes no bit.

    Args:
        P: (N, N) result, in its first n rows and columns.
        P_0: (N, N) covariance at the prediction.
        B: (n, n) Jacobian of the errors behind the correction by those before, I - K H.
        K: (n, m) gain.
        R: (m, m) covariance of the measurement noise.
        workspace: (1,) record of the filter.
    """
    n, m = K.shape
    A, C, wide = workspace[0].A, workspace[0].B, (n + 3) // 4 * 4
    is_full = np.zeros(n, np.bool_)
    for i in range(n):
        for k in range(n):
            C[i, k] = P_0[i, k]
            if B[i, k] != (1.0 if i == k else 0.0):
                is_full[k] = True
    for i in range(n):
        for j in range(wide):
            A[i, j] = 0.0
        for k in range(n):
            if is_full[k] or i == k:
                b = B[i, k]
                for j in range(wide):
                    A[i, j] += b * C[k, j]
    for k in range(n):
        for i in range(n):
            C[k, i] = B[i, k]
    row, of_R = np.empty(wide), np.empty(m)
    for i in range(n):
        row[:] = 0.0
        for k in range(n):
            a = A[i, k]
            if is_full[k]:
                for j in range(wide):
                    row[j] += a * C[k, j]
            else:
                row[k] += a
        for b in range(m):
            of_R[b] = 0.0
            for a in range(m):
                of_R[b] += K[i, a] * R[a, b]
        for j in range(i + 1):
            total = row[j]
            for b in range(m):
                total += of_R[b] * K[j, b]
            P[i, j] = total
            P[j, i] = total
