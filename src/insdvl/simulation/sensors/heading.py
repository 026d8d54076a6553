"""The simulated heading sensor: the attitude of base_link, and its errors."""

import math
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.frames import rotation_from_vector
from insdvl.parameters.declaration import parameter
from insdvl.simulation.motion import Truth
from insdvl.simulation.noise import gauss_markov


@dataclass(frozen=True)
class HeadingModel:
    """The simulated heading sensor, in the axes of base_link."""

    rate: float = parameter(
        0.0, "Attitudes per second; 0 for no sensor.", unit="Hz", low=0.0, high=1000.0
    )
    noise_std: float = parameter(
        math.radians(2.0), "White noise of the heading, one sigma.", unit="rad", low=0.0
    )
    error_std: float = parameter(
        math.radians(1.0),
        "Stationary sigma of a first-order Gauss-Markov error of the heading.",
        unit="rad",
        low=0.0,
    )
    error_time_constant: float = parameter(
        300.0, "Correlation time of the first-order Gauss-Markov error.", unit="s", above=0.0
    )
    roll_pitch_std: float = parameter(
        math.radians(0.5), "White noise of roll and pitch, one sigma.", unit="rad", low=0.0
    )

    @property
    def variances(self) -> tuple[float, float, float]:
        """Of the white noise about north, east and down [rad^2]."""
        return self.roll_pitch_std**2, self.roll_pitch_std**2, self.noise_std**2


def attitudes(truth: Truth, model: HeadingModel, rng: np.random.Generator) -> Array:
    """What the sensor tells: C_n_b (N, 3, 3) at equally spaced times.

    The tilt is turned by its noise, and then the heading by the sum of its errors. Each kind of
    error has a random stream of its own.

    Args:
        truth: At the times of the readings.
        model: The sensor.
        rng: Generator of the errors.
    """
    white, markov, tilts = rng.spawn(3)
    size = truth.t.size
    if size == 0:
        return np.empty((0, 3, 3))  # SciPy 1.11 has no rotations of nothing
    heading, tilt = np.zeros((size, 3)), np.zeros((size, 3))
    heading[:, 2] = model.noise_std * white.standard_normal(size)
    if model.rate > 0.0:
        steps = 1.0 / (model.rate * model.error_time_constant)
        heading[:, 2] += gauss_markov(np.full(1, model.error_std), steps, size, markov)[:, 0]
    tilt[:, :2] = model.roll_pitch_std * tilts.standard_normal((size, 2))
    return rotation_from_vector(heading) @ rotation_from_vector(tilt) @ truth.C_n_b
