"""The simulated IMU: its ideal readings, and its errors.

A reading is the mean of specific force and angular rate over the interval that ends at its stamp.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from insdvl.arrays import Array
from insdvl.parameters.declaration import ParameterError, parameter
from insdvl.simulation.motion import Trajectory

_NODES = 3  # the error is of the order dt^6 and lies below the rounding at 10 Hz and above
_VIBRATING_NODES = 6  # for half a period in an interval
_ORDER = 2  # of the low-pass


@dataclass(frozen=True)
class ImuModel:
    """The simulated IMU without its white noise, which a noise profile describes."""

    rate: float = parameter(100.0, "Samples per second.", unit="Hz", low=1.0, high=10_000.0)
    accelerometer_bias_std: float = parameter(
        1e-3, "Turn-on bias of each axis, one sigma.", unit="m/s^2", low=0.0
    )
    gyroscope_bias_std: float = parameter(
        1e-5, "Turn-on bias of each axis, one sigma.", unit="rad/s", low=0.0
    )
    accelerometer_bias_walk: float = parameter(
        1e-9, "Density of the accelerometer bias walk.", unit="(m/s^2)^2/s", low=0.0
    )
    gyroscope_bias_walk: float = parameter(
        1e-13, "Density of the gyroscope bias walk.", unit="(rad/s)^2/s", low=0.0
    )
    bandwidth: float = parameter(
        0.0,
        "Corner of a Butterworth low-pass of second order in the IMU, which noise and motion pass "
        "alike, with its delay; below half of imu.rate. 0 means none.",
        unit="Hz",
        low=0.0,
        high=5000.0,
    )

    def __post_init__(self) -> None:
        if self.bandwidth >= self.rate / 2.0:
            raise ParameterError(
                "parameter 'imu.bandwidth' must be below half of imu.rate, "
                f"{self.rate / 2.0:g} Hz, got {self.bandwidth!r}"
            )

    def filtered(self, readings: Array) -> Array:
        """Readings (N, 6) behind the low-pass, which is in its steady state at the first."""
        if self.bandwidth == 0.0:
            return readings
        from scipy.signal import butter, sosfilt, sosfilt_zi  # takes a second: for those with one

        sections = butter(_ORDER, self.bandwidth, fs=self.rate, output="sos")
        before = sosfilt_zi(sections)[:, :, None] * readings[0]
        return np.asarray(sosfilt(sections, readings, axis=0, zi=before)[0])


def ideal_imu(
    trajectory: Trajectory, stamps_s: Array, dt: float, *, earth_rate: bool = True
) -> tuple[Array, Array]:
    """Readings of a perfect IMU: means over (stamp - dt, stamp], by Gauss-Legendre quadrature.

    Args:
        trajectory: The motion.
        stamps_s: (N,) ends of the intervals, from the start of the trajectory [s].
        dt: Length of the intervals [s].
        earth_rate: See `Trajectory.truth`.

    Returns:
        f_b (N, 3) [m/s^2] and w_ib_b (N, 3) [rad/s] in forward-right-down.
    """
    nodes = _NODES if trajectory.vibration is None else _VIBRATING_NODES
    x, w = legendre.leggauss(nodes)
    t = np.asarray(stamps_s)[:, None] + dt / 2.0 * (x - 1.0)
    truth = trajectory.truth(t.ravel(), earth_rate=earth_rate)

    def mean(values: Array) -> Array:
        return np.ascontiguousarray(np.einsum("j,ijk->ik", w / 2.0, values.reshape(-1, nodes, 3)))

    return mean(truth.f_b), mean(truth.w_ib_b)


def white_noise(variances: Array, rng: np.random.Generator) -> Array:
    """Independent normal noise (N, 6) with the given variance of each sample (N, 6)."""
    return np.sqrt(variances) * rng.standard_normal(variances.shape)


def biases(n: int, dt: float, turn_on_std: Array, walk: Array, rng: np.random.Generator) -> Array:
    """Biases (n, 6): a turn-on value, then a random walk.

    Args:
        n: Number of samples; the first one has the turn-on bias.
        dt: Time between samples [s].
        turn_on_std: (6,) sigma of the turn-on bias of each channel [unit].
        walk: (6,) density of the walk of each channel [unit^2/s].
        rng: Generator of the draws; their number does not depend on the sigmas.
    """
    steps = rng.standard_normal((n, 6))
    steps[0] *= turn_on_std
    steps[1:] *= np.sqrt(np.asarray(walk) * dt)
    return np.cumsum(steps, axis=0)
