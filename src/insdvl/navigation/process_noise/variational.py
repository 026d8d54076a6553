"""The predicted covariance, inferred at each update by variational Bayes."""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import ProcessNoiseSource
from insdvl.navigation.state.fields import State

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
        H: (m, n) measurement matrix.
        R: (m, m) covariance of the measurement noise.
        innovation: (m,) nu.
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


class Variational(ProcessNoiseSource):
    """Leaves Q as it is, and adapts the predicted covariance to each innovation."""

    adapts = True

    def __init__(self, parameters: ProcessNoiseParameters, C_b_i: Array) -> None:
        super().__init__(parameters, C_b_i)
        self._tau = parameters.adaptive_prior

    def before_correction(self, s: State, now: Innovated, seconds: float) -> Innovated:
        """Replace P by what the innovation says of it."""
        n = now.H.shape[1]
        P = s["nav"]["P"]
        P[:n, :n] = variational(P[:n, :n], now.H, now.R, now.innovation, self._tau)
        return kalman.innovate(P, now.innovation, now.H, now.R)
