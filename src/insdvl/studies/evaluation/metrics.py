"""Errors of a navigation result against the truth, and the numbers that summarise them.

Arrays are over N stamps. The navigation frame is NED or ENU, the body frame FRD or FLU; result and
truth must be in the same frames.

The error of an attitude is the rotation vector psi about navigation axes with
C_true = exp([psi x]) C_hat, as in the filter.
"""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.rotation import quaternions


@dataclass(frozen=True)
class Track:
    """A navigation result, or the truth, over N stamps.

    Attributes:
        C_n_b: (N, 3, 3) attitude, against local axes or against odom's.
        v_b: (N, 3) velocity over ground in body axes [m/s].
        p_o: (N, 3) position in odom [m].
    """

    C_n_b: Array
    v_b: Array
    p_o: Array

    @property
    def v_n(self) -> Array:
        """(N, 3) velocity over ground in navigation axes [m/s]."""
        return np.einsum("kij,kj->ki", self.C_n_b, self.v_b)


def rmse(error: Array) -> float:
    """sqrt(mean_k |e_k|^2) of errors (N, m), or (N,), in their unit."""
    e = error.reshape(len(error), -1)
    return float(np.sqrt(np.mean(np.sum(e**2, axis=1))))


def smae(error: Array) -> float:
    """mean_k sum_j |e_jk| of errors (N, m), in their unit."""
    return float(np.mean(np.sum(np.abs(error), axis=1)))


def attitude_error(C: Array, C_true: Array) -> Array:
    """psi (N, 3) [rad] about navigation axes, with C_true = exp([psi x]) C."""
    q = np.empty((len(C), 4))
    quaternions(q, C_true @ np.swapaxes(C, -1, -2))
    vector, scalar = q[:, :3], q[:, 3:]
    sine = np.linalg.norm(vector, axis=1, keepdims=True)  # of half the angle
    angle = 2.0 * np.arctan2(sine, scalar)
    return vector * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)


def path_length(p_o: Array) -> float:
    """Length [m] of a path through positions (N, 3)."""
    return float(np.sum(np.linalg.norm(np.diff(p_o, axis=0), axis=1)))


def inside_fraction(error: Array, sigma: Array, times: float = 3.0) -> float:
    """Fraction of the components (N, m) of an error that are within a number of sigmas (N, m)."""
    return float(np.mean(np.abs(error) <= times * sigma))


def normalised_innovations(innovation: Array, S: Array) -> Array:
    """L^-1 nu (M, 3), with S = L L^T: independent and of unit variance when all is well.

    Args:
        innovation: (M, 3) nu.
        S: (M, 3, 3) covariance of nu.
    """
    return np.linalg.solve(np.linalg.cholesky(S), innovation[..., None])[..., 0]


def nees(error: Array, P: Array) -> Array:
    """Normalised estimation error squared e^T P^-1 e (K,): m on average when all is well.

    Args:
        error: (K, m) e.
        P: (K, m, m) covariance of e; the answer is nan where it is not positive definite.
    """
    out = np.empty(len(error))
    _nees(np.ascontiguousarray(error), np.ascontiguousarray(P), out)
    return out


@kernel
def _nees(error: Array, P: Array, out: Array) -> None:
    """|L^-1 e|^2 with P = L L^T."""
    m = error.shape[1]
    L = np.empty((m, m))
    z = np.empty(m)
    for k in range(error.shape[0]):
        out[k] = 0.0
        for i in range(m):
            for j in range(i + 1):
                total = P[k, i, j]
                for a in range(j):
                    total -= L[i, a] * L[j, a]
                L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            z[i] = error[k, i]
            for a in range(i):
                z[i] -= L[i, a] * z[a]
            z[i] /= L[i, i]
            out[k] += z[i] ** 2


def autocorrelation(z: Array, lags: int) -> list[float]:
    """Autocorrelation of a sequence (M, m) at the lags 1, 2, ... up to lags < M.

    rho_l = sum_k z_k . z_(k+l) / sum_k |z_k|^2. The mean is not taken out: what should be white has
    none. Of white noise each is about +-1 / sqrt(m M).
    """
    power = float(np.sum(z**2))
    return [float(np.sum(z[:-lag] * z[lag:])) / power for lag in range(1, lags + 1)]


@dataclass(frozen=True)
class Scores:
    """The error of one run over all of its stamps.

    Attributes:
        body_velocity_rmse: Of the velocity in body axes [m/s]: what DVL and IMU can observe.
        srmse: sqrt(mean_k |dv_k|^2) of the velocity in navigation axes [m/s]; mostly heading.
        smae: mean_k sum_j |dv_jk| of the same [m/s].
        heading_rmse_deg: Of the rotation about the vertical [deg].
        tilt_rmse_deg: Of the rotation about both horizontal axes [deg].
        position_rmse_horizontal: [m].
        position_drift_percent: Horizontal error at the end in percent of the distance travelled.
    """

    body_velocity_rmse: float
    srmse: float
    smae: float
    heading_rmse_deg: float
    tilt_rmse_deg: float
    position_rmse_horizontal: float
    position_drift_percent: float


def scores(result: Track, truth: Track) -> Scores:
    """The scores of a result against the truth at the same N > 1 stamps.

    The third navigation axis is vertical. A vehicle that does not move has no drift in percent
    (nan).
    """
    dv_n = truth.v_n - result.v_n
    psi = np.degrees(attitude_error(result.C_n_b, truth.C_n_b))
    dp = (truth.p_o - result.p_o)[:, :2]
    distance = path_length(truth.p_o)
    final = float(np.linalg.norm(dp[-1]))
    return Scores(
        body_velocity_rmse=rmse(truth.v_b - result.v_b),
        srmse=rmse(dv_n),
        smae=smae(dv_n),
        heading_rmse_deg=rmse(psi[:, 2]),
        tilt_rmse_deg=rmse(psi[:, :2]),
        position_rmse_horizontal=rmse(dp),
        position_drift_percent=100.0 * final / distance if distance > 0.0 else float("nan"),
    )
