"""Grades of IMU: noise and turn-on bias of the units that studies and tests speak of."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians, sqrt
from types import MappingProxyType

import numpy as np

from insdvl.arrays import Array
from insdvl.simulation.drawn.scenarios import GYROSCOPE, MIDDLE, Scenario
from insdvl.simulation.sensors.imu import ImuModel

_MICRO_G = 9.80665e-6  # m/s^2


@dataclass(frozen=True)
class Grade:
    """What a data sheet says of an IMU.

    Attributes:
        accelerometer_noise: Velocity random walk [m/s^2/sqrt(Hz)].
        accelerometer_bias: Turn-on bias, one sigma [m/s^2].
        gyroscope_noise: Angular random walk [rad/sqrt(s)].
        gyroscope_bias: Turn-on bias, one sigma [rad/s].
    """

    accelerometer_noise: float
    accelerometer_bias: float
    gyroscope_noise: float
    gyroscope_bias: float

    def variances(self, rate: float = 100.0) -> Array:
        """Variance (6,) of the white noise in a sample at a rate [Hz], f x, y, z then w x, y, z."""
        densities = np.square([self.accelerometer_noise, self.gyroscope_noise])
        return np.repeat(densities * rate, 3)

    def scale(self, rate: float = 100.0) -> tuple[float, float]:
        """Variances per sample of f and w over the middle of those that a scenario draws."""
        f, w = self.variances(rate)[[0, 3]].tolist()
        return f / MIDDLE, w / (MIDDLE * GYROSCOPE)

    def of_scenario(self, scenario: Scenario, rate: float = 100.0) -> Scenario:
        """The scenario with the noise of this grade: its variances are in the middle of the draws.

        What is motion stays, and so do counts, and errors of scale and alignment
        (docs/explanation/effective-noise.md).
        """
        return replace(scenario, scale=self.scale(rate))

    def imu(self, rate: float = 100.0) -> ImuModel:
        """The simulated IMU; its biases stay, its white noise is a profile of `variances`."""
        return ImuModel(
            rate=rate,
            accelerometer_bias_std=self.accelerometer_bias,
            gyroscope_bias_std=self.gyroscope_bias,
            accelerometer_bias_walk=0.0,
            gyroscope_bias_walk=0.0,
        )


def _grade(noise_ug: float, bias_mg: float, walk_deg: float, bias_deg: float) -> Grade:
    """From ug/sqrt(Hz), mg, deg/sqrt(h) and deg/h."""
    return Grade(
        accelerometer_noise=noise_ug * _MICRO_G,
        accelerometer_bias=bias_mg * 1e3 * _MICRO_G,
        gyroscope_noise=radians(walk_deg) / sqrt(3600.0),
        gyroscope_bias=radians(bias_deg) / 3600.0,
    )


GRADES: Mapping[str, Grade] = MappingProxyType(
    {
        "fog": _grade(50.0, 0.1, 0.003, 0.01),
        "tactical": _grade(100.0, 1.0, 0.1, 1.0),
        "mems": _grade(1000.0, 5.0, 0.3, 100.0),
    }
)
