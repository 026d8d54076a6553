"""The Doppler velocity log: velocity over ground at its place, in its axes, and its errors."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from insdvl.simulation.trajectories import Truth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DvlModel:
    """A DVL and its errors.

    Attributes:
        rate: Pings per second [Hz].
        C_b_d: (3, 3) rotation from DVL axes to body axes.
        l_b_dvl: (3,) position in the body frame [m].
        noise_std: (3,) white noise of each component [m/s].
        bias_std: Stationary sigma of a first-order Gauss-Markov error of each component [m/s].
        bias_time_constant: Its correlation time [s].
        outages: Times (start, end) without pings, start <= t < end [s].
        outlier_probability: Probability that a ping is an outlier.
        outlier_size: Length of the vector, of random direction, that is added to an outlier [m/s].
    """

    rate: float = 1.0
    C_b_d: Array = field(default_factory=lambda: np.eye(3))
    l_b_dvl: Array = field(default_factory=lambda: np.zeros(3))
    noise_std: Array = field(default_factory=lambda: np.full(3, 0.1))
    bias_std: float = 0.0
    bias_time_constant: float = 10.0
    outages: tuple[tuple[float, float], ...] = ()
    outlier_probability: float = 0.0
    outlier_size: float = 3.0

    def errors(self, t: Array, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
        """Errors of all pings at equally spaced times t (N,).

        Each kind of error has a stream of its own, so that a setting changes its own error only,
        and the number of pings none.

        Returns:
            The errors (N, 3) [m/s], and which pings are outliers (N,).
        """
        white, markov, chance, directions = rng.spawn(4)
        errors = self.noise_std * white.standard_normal((t.size, 3))
        drive = markov.standard_normal((t.size, 3))
        decay = np.exp(-1.0 / (self.rate * self.bias_time_constant))
        bias = self.bias_std * drive[:1]
        for k in range(t.size):
            if k > 0:
                bias = decay * bias + self.bias_std * np.sqrt(1.0 - decay**2) * drive[k]
            errors[k] += bias.ravel()
        is_outlier = chance.random(t.size) < self.outlier_probability
        direction = directions.standard_normal((t.size, 3))
        direction *= self.outlier_size / np.linalg.norm(direction, axis=1, keepdims=True)
        errors[is_outlier] += direction[is_outlier]
        return errors, is_outlier

    def available(self, t: Array) -> NDArray[np.bool_]:
        """Which of the times (N,) lie outside the outages."""
        seen = np.ones(t.size, dtype=bool)
        for start, end in self.outages:
            seen &= (t < start) | (t >= end)
        return seen


def ideal_velocity(truth: Truth, model: DvlModel) -> Array:
    """What a perfect DVL measures (N, 3): C_d_b (C_b_n v_n + w_nb_b x l_b_dvl) [m/s]."""
    v_b = np.einsum("kji,kj->ki", truth.C_n_b, truth.v_n)
    v_b += np.cross(truth.w_nb_b, model.l_b_dvl)
    return v_b @ model.C_b_d
