"""The effective density: the white noise with which a filter's told variance is the true one.

A filter that believes in white noise has a steady gain, which follows from the densities it is
told and from the DVL. The gain decides what of the spectrum of the true noise reaches the estimate.
The effective density is the one which gives the gain with which the true noise causes the variance
that the filter tells: a fixed point. See docs/explanation/effective-noise.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import asinh, exp, log, sqrt

from insdvl.arrays import Array
from insdvl.simulation.drawn.spectrum import Spectrum, energy

_GRAVITY = 9.8  # m/s^2; its place on the Earth changes no effective density
_TOLERANCE = 1e-10  # of the logarithm of a density
_STEPS = 500


@dataclass(frozen=True)
class Dvl:
    """What decides the gain: the DVL as the filter sees it.

    Attributes:
        variance: Of each component of a ping [(m/s)^2].
        interval: Between pings [s].
    """

    variance: float
    interval: float


def memory_rate(density: float, dvl: Dvl) -> float:
    """-ln(1 - K) / T [rad/s] of the steady gain K of a scalar velocity filter.

    From the steady state K^2 / (1 - K) = q T / R follows 4 sinh^2(-ln(1 - K) / 2) = q T / R.

    Args:
        density: q, of the acceleration [(m/s^2)^2/Hz].
        dvl: R and T.
    """
    return 2.0 * asinh(0.5 * sqrt(density * dvl.interval / dvl.variance)) / dvl.interval


def vertical(accelerometer: Spectrum, dvl: Dvl) -> float:
    """Effective density of an accelerometer whose velocity depends on no tilt.

    Raises:
        ValueError: The spectrum is zero.
    """

    def caused(densities: Sequence[float]) -> tuple[float]:
        filtered = (1.0,), (1.0, memory_rate(densities[0], dvl))
        return (accelerometer.variance_behind(*filtered) / energy(*filtered),)

    return _fixed_point(caused, (dvl.variance / dvl.interval,))[0]


def horizontal(accelerometer: Spectrum, gyroscope: Spectrum, dvl: Dvl) -> tuple[float, float]:
    """Effective densities of an accelerometer and of the gyroscope that tilts it.

    Raises:
        ValueError: A spectrum is zero.
    """

    def caused(densities: Sequence[float]) -> tuple[float, float]:
        k_1, k_2 = gains(densities[0], densities[1], dvl)
        denominator = (1.0, k_1, _GRAVITY * k_2)
        in_velocity, in_tilt = (1.0, 0.0), (1.0, k_1)
        return (
            accelerometer.variance_behind(in_velocity, denominator)
            / energy(in_velocity, denominator),
            gyroscope.variance_behind(in_tilt, denominator) / energy(in_tilt, denominator),
        )

    start = dvl.variance / dvl.interval
    q_f, q_w = _fixed_point(caused, (start, start / _GRAVITY**2))
    return q_f, q_w


def gains(q_f: float, q_w: float, dvl: Dvl) -> tuple[float, float]:
    """Steady gains of velocity [1/s] and of tilt [rad/m] per innovation and second.

    Args:
        q_f: Density of the accelerometer [(m/s^2)^2/Hz].
        q_w: Density of the gyroscope [(rad/s)^2/Hz].
        dvl: Of the filter.
    """
    r = dvl.variance * dvl.interval
    k_1 = memory_rate(q_f + 2.0 * _GRAVITY * sqrt(q_w * r), dvl)
    return k_1, sqrt(q_w / r)


def measured(white: Array, variance: float, tau: float, k_1: float, interval: float) -> Array:
    """Effective variances (M,) of pings with a white error and a first-order one.

    The velocity of the filter is a sum of pings with weights that fall by a = exp(-k_1 T) from one
    to the one before. Of an error that falls by rho over T the variance of the sum is
    (1 + a rho) / (1 - a rho) times that of a white error of the same variance.

    Args:
        white: (M,) variances of the white error [(m/s)^2].
        variance: Of the first-order error [(m/s)^2].
        tau: Its time constant [s].
        k_1: Gain of the velocity [1/s].
        interval: T, between pings [s].
    """
    a_rho = exp(-(k_1 + 1.0 / tau) * interval)
    return white + variance * (1.0 + a_rho) / (1.0 - a_rho)


def _fixed_point(
    caused: Callable[[Sequence[float]], tuple[float, ...]], start: tuple[float, ...]
) -> tuple[float, ...]:
    """The densities which cause themselves.

    For one density each step at least halves the error of the logarithm, from any start.
    """
    told = start
    for _ in range(_STEPS):
        found = caused(told)
        if min(found) <= 0.0:
            raise ValueError("an effective density needs noise, got a spectrum of zero")
        change = max(abs(log(a / b)) for a, b in zip(found, told, strict=True))
        told = found
        if change < _TOLERANCE:
            return told
    raise ValueError(f"no effective density found in {_STEPS} steps")
