"""Noise that is not white, for the samples of a recording."""

from dataclasses import dataclass, replace

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.navigation.events import NS
from insdvl.simulation.drawn.scenarios import DRAWN, Disturbances, vibration_in_samples
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.imu import white_noise


@dataclass(frozen=True)
class DrawnNoise:
    """The noise of the IMU of a vehicle that is drawn as in a scenario.

    Vibration is in the samples alone. The velocity that it makes, some mm/s, is in no ping and not
    in the reference: it is an error of all filters alike.

    Attributes:
        scenario: ``vibrating`` or ``coloured``.
        dvl: Noise and rate, on which the effective variances depend.
        seed: Random seed.
    """

    scenario: str
    dvl: DvlModel
    seed: int

    def draw(self, stamps_ns: Stamps) -> tuple[Array, Array]:
        """Effective variances (N, 6) and noise (N, 6) of each sample, in the axes of the stream."""
        white_rng, vehicle, samples, errors = np.random.default_rng(self.seed).spawn(4)
        t, dt = (stamps_ns - stamps_ns[0]) / NS, float(np.median(np.diff(stamps_ns))) / NS
        duration, rate, scenario = float(t[-1]) + 1.0, 1.0 / dt, DRAWN[self.scenario]
        white = scenario.profile()(duration, white_rng)
        imu = scenario.draw(duration, rate, vehicle).imu
        if scenario.vibrating:
            imu = replace(imu, lines=vibration_in_samples(rate, vehicle))
        noise = white_noise(white.variance_at(t), samples) + imu.noise(t, dt, errors)
        q, _ = Disturbances(imu).effective(white, np.ones(1), self.dvl, rate, duration)
        return q.variance_at(t), noise
