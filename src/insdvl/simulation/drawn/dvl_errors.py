"""Noise of a DVL that depends on its height above the bottom, on speed and on the bottom itself.

The sigma of the white noise of a ping is that of the data sheet times

    b sqrt((1 + (h / h_1)^2 + (u / u_1)^2) / 3)

with the altitude h, the speed u, and a factor b of the bottom.
"""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.simulation.motion import Truth
from insdvl.simulation.noise import NoiseProfile, segments

ALTITUDE, SPEED = 30.0, 1.0  # m, m/s: h_1 and u_1
BOTTOM = (0.25, 2.5)  # factor b, drawn log-uniformly every 15 to 45 s
MEAN_ALTITUDE = (10.0, 50.0)  # m, drawn uniformly
HILLS = (1.0, 3.0)  # m, amplitude of each of three sines in the altitude, drawn uniformly
HILL_PERIOD = (40.0, 200.0)  # s, their periods, drawn uniformly
#: The slowly varying error: its sigma relative to the data sheet's, and its time constant [s], both
#: drawn log-uniformly.
CORRELATED = (0.1, 0.5)
CORRELATION_TIME = (5.0, 30.0)


@dataclass(frozen=True, eq=False)
class DvlErrors:
    """What is drawn of a DVL and its surroundings.

    Attributes:
        altitude: Mean height above the bottom [m].
        hills: (3, 3) amplitude [m], period [s] and phase [rad] of each sine in the altitude.
        bottom: Squared factor b^2 over time, in its first channel.
        correlated: Sigma of the slowly varying error relative to the data sheet's.
        correlation_time: [s].
    """

    altitude: float
    hills: Array
    bottom: NoiseProfile
    correlated: float
    correlation_time: float

    def factors(self, truth: Truth) -> Array:
        """Factors (M,) on the sigma of the white noise of pings, of which this is the truth."""
        amplitude, period, phase = self.hills.T
        angle = 2.0 * np.pi * truth.t[:, None] / period + phase
        altitude = self.altitude + np.sin(angle) @ amplitude
        speed = np.linalg.norm(truth.v_n, axis=1)
        b = np.sqrt(self.bottom.variance_at(truth.t)[:, 0])
        shape = (1.0 + (altitude / ALTITUDE) ** 2 + (speed / SPEED) ** 2) / 3.0
        return np.asarray(b * np.sqrt(shape), dtype=np.float64)


def drawn_dvl_errors(duration: float, rng: np.random.Generator) -> DvlErrors:
    """A DVL and the bottom of one mission of a duration [s]."""
    low, high = BOTTOM
    return DvlErrors(
        altitude=rng.uniform(*MEAN_ALTITUDE),
        hills=np.stack(
            [
                rng.uniform(*HILLS, 3),
                rng.uniform(*HILL_PERIOD, 3),
                rng.uniform(0.0, 2.0 * np.pi, 3),
            ],
            axis=1,
        ),
        bottom=segments(low**2, high**2)(duration, rng),
        correlated=_log_uniform(CORRELATED, rng),
        correlation_time=_log_uniform(CORRELATION_TIME, rng),
    )


def _log_uniform(limits: tuple[float, float], rng: np.random.Generator) -> float:
    low, high = np.log(limits)
    return float(np.exp(rng.uniform(low, high)))
