"""Exact zeros of a DVL: of a vehicle at rest, or of a DVL without bottom lock.

Neither the DVL nor the IMU alone tells the two apart: a steady cruise looks like rest to an IMU. So
the filter's own velocity has to say it. Derivation: docs/explanation/start.md.
"""

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, GYROSCOPE_BIAS
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.earth import gravity
from insdvl.navigation.measurements.base import Linearised, Vehicle
from insdvl.navigation.start import rest
from insdvl.navigation.start.gyrocompass import noise_of
from insdvl.navigation.state.fields import State

#: Samples of a time before the measurement have to show a vehicle at rest: of at least the first
#: [s], at most the second, and so many of them that each half has enough for the tests.
SHORTEST, LONGEST, SAMPLES = 0.5, 3.0, 12
#: Each component of the filter's own velocity, and one sigma of it, is below this [m/s], and the
#: component within so many sigma of zero.
KNOWN, SIGMAS = 0.1, 3.0


def window_ns(rate: float) -> int:
    """Length of the time before a measurement that is looked at [ns], of an IMU's rate [Hz]."""
    return round(min(max(SHORTEST, SAMPLES / rate), LONGEST) * NS)


def confirmed(s: State, vehicle: Vehicle, linearised: Linearised, samples: Array) -> bool:
    """Whether a measured velocity of exactly zero is that of a vehicle at rest.

    Args:
        s: State at the measurement.
        vehicle: That carries the sensor.
        linearised: The measurement, z = 0, so that its innovation is minus the own velocity.
        samples: (N, 6) of the IMU over `window_ns`, f then w, base_link axes, without those that
            are not believed.
    """
    nav, n = s["nav"], vehicle.n
    P, H = nav["P"][:n, :n], linearised.H
    sigma = np.sqrt(np.diag(H @ P @ H.T))
    largest = np.minimum(SIGMAS * sigma, KNOWN)
    if not ((sigma < KNOWN) & (np.abs(linearised.z_minus_h) <= largest)).all():
        return False
    rate = float(vehicle.constants[0]["rate"])
    if len(samples) < rate * window_ns(rate) / NS / 2.0:
        return False
    std_f, std_w = (
        float(np.sqrt(np.diag(P[at, at]).max())) for at in (ACCELEROMETER_BIAS, GYROSCOPE_BIAS)
    )
    bias = np.concatenate([nav["b_f"], nav["b_w"]])
    noise = noise_of(s, vehicle.constants[0], std_f, std_w)
    g = gravity(nav["llh"][0], nav["llh"][2])
    return rest.misfit_to_rest(rest.window_of(samples), bias, noise, g).worst <= 1.0
