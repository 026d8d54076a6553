"""Where the process noise comes from.

The state record holds the variances in effect (``Q_f``, ``Q_w``), the stamp of a Q that was told
(``q_ns``) and, for the adaptive source, a density in the model's coordinates (``Q_x``). These
functions are the only ones that write them, apart from the time-out in the prediction kernel.

Sources: `constant` keeps the nominal; `external`, `message` and `oracle` are told a `ProcessNoise`;
`adaptive` estimates from the innovations: Q itself, or what a wrong Q has made of the predicted
covariance.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters, ProcessNoiseParameters
from insdvl.navigation.state import NEVER, State

Array = NDArray[np.float64]


def nominal(parameters: ProcessNoiseParameters, C_b_i: Array) -> tuple[Array, Array]:
    """Nominal variances per sample (Q_f, Q_w), each (3, 3), rotated from IMU to base_link axes."""
    Q_f = C_b_i @ np.diag(parameters.accelerometer_variance) @ C_b_i.T
    Q_w = C_b_i @ np.diag(parameters.gyroscope_variance) @ C_b_i.T
    return _symmetric(Q_f), _symmetric(Q_w)


def _symmetric(Q: Array) -> Array:
    """Without what rounding makes of a product; P is as symmetric as Q is."""
    return (Q + Q.T) / 2


def bounded(Q: Array, floor: float, ceiling: float) -> tuple[Array, bool, bool]:
    """A covariance (3, 3) with every variance, in any direction, between a floor and a ceiling.

    Returns:
        The covariance, whether the floor acted, and whether the ceiling did.
    """
    diagonal = np.diagonal(Q)
    if np.count_nonzero(Q - np.diag(diagonal)) == 0:
        low, high = bool((diagonal < floor).any()), bool((diagonal > ceiling).any())
        return np.diag(np.clip(diagonal, floor, ceiling)), low, high
    variances, axes = np.linalg.eigh(Q)
    low, high = bool(variances[0] < floor), bool(variances[-1] > ceiling)
    if not (low or high):
        return Q, False, False
    return (axes * np.clip(variances, floor, ceiling)) @ axes.T, low, high


#: Towards the fixed point of `variational`: what five leave to do is below a millionth of P.
_ITERATIONS = 5


def variational(P: Array, H: Array, R: Array, innovation: Array, tau: float) -> Array:
    """Predicted covariance (n, n) that variational Bayes infers from one innovation.

    P has an inverse-Wishart prior around the filter's own prediction, which counts as much as tau
    innovations (Huang, Zhang, Wu, Li and Chambers, "A novel adaptive Kalman filter with inaccurate
    process and measurement noise covariance matrices", IEEE Transactions on Automatic Control
    63(2), 2018; here R is known). Its fixed point is

        P_hat = (tau P + A) / (tau + 1),  A = dx dx^T + (I - K H) P_hat,
        dx = K nu,  K = P_hat H^T (H P_hat H^T + R)^-1.

    Args:
        P: (n, n) predicted covariance.
        H: (3, n) measurement matrix.
        R: (3, 3) covariance of the measurement noise.
        innovation: (3,) nu.
        tau: Weight of the prediction, > 0.
    """
    P_hat = P
    for _ in range(_ITERATIONS):
        PHt = P_hat @ H.T
        K = np.linalg.solve(H @ PHt + R, PHt.T).T
        dx = K @ innovation
        P_hat = (tau * P + np.outer(dx, dx) + P_hat - K @ PHt.T) / (tau + 1.0)
        P_hat = (P_hat + P_hat.T) / 2
    return P_hat


class ProcessNoiseSource:
    """Keeps the process noise of a state record up to date.

    Args:
        parameters: Of the filter.
        C_b_i: (3, 3) rotation from IMU to base_link axes.
    """

    def __init__(self, parameters: FilterParameters, C_b_i: Array) -> None:
        self._parameters = parameters.process_noise
        self._C_b_i = C_b_i
        self.Q_f_nominal, self.Q_w_nominal = nominal(parameters.process_noise, C_b_i)
        form = self._parameters.adaptive_form if self._parameters.source == "adaptive" else None
        #: Weight of the prediction in `variational`; None where that is not in use.
        self.tau = self._parameters.adaptive_prior if form == "variational" else None
        #: Number of innovations in the state record.
        self.window = self._parameters.adaptive_window if form in ("floored", "literal") else 0

    def start(self, s: State) -> None:
        """The nominal Q takes effect."""
        s["Q_f"], s["Q_w"], s["q_ns"] = self.Q_f_nominal, self.Q_w_nominal, NEVER
        s["Q_x"], s["innovation_count"] = 0.0, 0

    def told(self, s: State, stamp_ns: int, Q_f: Array | None, Q_w: Array | None) -> None:
        """A Q in IMU axes takes effect; a part that is None (unknown) is nominal from now on."""
        p, C = self._parameters, self._C_b_i
        low_f = high_f = low_w = high_w = False
        if Q_f is None:
            Q_f = self.Q_f_nominal
        else:
            Q_f, low_f, high_f = bounded(Q_f, p.accelerometer_floor, p.accelerometer_ceiling)
            Q_f = _symmetric(C @ Q_f @ C.T)
        if Q_w is None:
            Q_w = self.Q_w_nominal
        else:
            Q_w, low_w, high_w = bounded(Q_w, p.gyroscope_floor, p.gyroscope_ceiling)
            Q_w = _symmetric(C @ Q_w @ C.T)
        s["Q_f"], s["Q_w"], s["q_ns"] = Q_f, Q_w, stamp_ns
        s["floors"] += int(low_f or low_w)
        s["ceilings"] += int(high_f or high_w)

    def innovated(self, s: State, K: Array, innovation: Array) -> None:
        """After an accepted update the adaptive source estimates Q from the last xi innovations.

        Q_x = K (1/xi sum nu nu^T) K^T (Or and Klein, section II; Mohamed and Schwarz, 1999) is the
        covariance of the steps up to the next update, spread evenly over the interval.

        Args:
            K: (n, 3) gain of the update.
            innovation: (3,) of the update.
        """
        if not self.window:
            return
        slot = int(s["innovation_count"]) % self.window
        s["innovations"][slot] = innovation
        s["innovation_count"] += 1
        interval_ns = int(s["time_ns"]) - int(s["dvl_ns"])
        if s["innovation_count"] >= self.window and s["dvl_ns"] != NEVER and interval_ns > 0:
            nu = s["innovations"]
            s["Q_x"] = _symmetric(K @ (nu.T @ nu / self.window) @ K.T / (interval_ns / NS))
