"""Q, or Q and R, by the recursions of Sage and Husa, from each innovation."""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation import kalman
from insdvl.navigation.error_state import ATTITUDE, VELOCITY
from insdvl.navigation.geometry.rotation import cross_matrix
from insdvl.navigation.kalman import Innovated
from insdvl.navigation.measurements.base import Vehicle
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.process_noise.received import ProcessNoiseSource
from insdvl.navigation.state.fields import State

#: The least R, and the largest, over that of the sensor. Without bounds the difference in the
#: recursion of R may be negative.
_BOUNDS = (0.01, 100.0)


class SageHusa(ProcessNoiseSource):
    """Adapts the variances of the IMU to the innovations, and those of the DVL where asked.

    With d = (1 - b) / (1 - b^(k + 1)) at the k-th innovation nu, of covariance S = H P H^T + R,

        R <- R + d (nu nu^T - S),
        Q_x <- Q_x + d K (nu nu^T - S) K^T.

    The second is the recursion for the covariance that the noise has added since the update
    before, Q_x <- (1 - d) Q_x + d (K nu nu^T K^T + P+ - Phi P Phi^T), since P+ = P- - K S K^T and
    P- = Phi P Phi^T + Q_x (Sage and Husa, "Adaptive filtering with unknown prior statistics", Joint
    Automatic Control Conference, 1969; with the forgetting factor b as is usual since). Of R and Q
    the variances are kept; Q_x is told as variances of the IMU by its blocks of velocity and
    attitude. An innovation alone does not tell whether Q or R is wrong: together the two recursions
    need not find either.

    The state keeps the variances of R in the first row of ``innovations``.
    """

    adapts = True

    def __init__(
        self, parameters: ProcessNoiseParameters, vehicle: Vehicle, *, with_r: bool
    ) -> None:
        super().__init__(parameters, vehicle.C_b_i)
        self._vehicle, self._with_r = vehicle, with_r

    def before_correction(self, s: State, now: Innovated, seconds: float) -> Innovated:
        """Take the innovation into R and Q, and weight it with the new R."""
        b, of_nu = self._parameters.adaptive_forgetting, np.outer(now.innovation, now.innovation)
        s["noise"]["innovation_count"] += 1
        d = (1.0 - b) / (1.0 - b ** (int(s["noise"]["innovation_count"]) + 1))
        if self._with_r:
            now = self._with_adapted_r(s, now, d)
        if seconds > 0.0:
            self._take(s, d / seconds * (now.K @ (of_nu - now.S) @ now.K.T))
        return now

    @staticmethod
    def _with_adapted_r(s: State, now: Innovated, d: float) -> Innovated:
        """Take the innovation into R, and compare it with its prediction again."""
        noise, told = s["noise"], np.diagonal(now.R)
        R = told if noise["innovation_count"] == 1 else noise["innovations"][0]
        S = np.diagonal(now.S) - told + R
        low, high = _BOUNDS
        R = np.clip(R + d * (now.innovation**2 - S), low * told, high * told)
        noise["innovations"][0] = R
        return kalman.innovate(s["nav"]["P"], now.innovation, now.H, np.diag(R))

    def _take(self, s: State, added: Array) -> None:
        """Take a density (n, n) in the model's coordinates into Q."""
        p, nav, noise = self._parameters, s["nav"], s["noise"]
        C = nav["C_n_b"]
        to_velocity = np.zeros((3, len(added)))
        to_velocity[:, VELOCITY] = np.eye(3)
        if self._vehicle.invariant:
            to_velocity[:, ATTITUDE] = -cross_matrix(nav["v_n"])
        of_velocity = C.T @ to_velocity @ added @ to_velocity.T @ C
        of_attitude = C.T @ added[ATTITUDE, ATTITUDE] @ C
        density = float(self._vehicle.constants[0]["density"])
        for name, block, low, high in (
            ("Q_f", of_velocity, p.accelerometer_floor, p.accelerometer_ceiling),
            ("Q_w", of_attitude, p.gyroscope_floor, p.gyroscope_ceiling),
        ):
            variances = np.diagonal(noise[name]) + np.diagonal(block) / density
            noise[name] = np.diag(np.clip(variances, low, high))
