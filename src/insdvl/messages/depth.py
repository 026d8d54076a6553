"""Depth from a pressure, or from the height in a pose or an odometry."""

import math
from typing import Any

from insdvl.messages.convert import RejectedMessage, sensor_stamp_ns
from insdvl.navigation.geometry.frames import Convention
from insdvl.navigation.measurements.depth import STANDARD_GRAVITY, Depth, DepthParameters

PRESSURE = "sensor_msgs/msg/FluidPressure"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
#: Types that `depth` converts.
TYPES = (PRESSURE, POSE, ODOMETRY)

#: Place of the variance of z in a row-major (6, 6) covariance.
_Z_VARIANCE = 14


def depth(message: Any, convention: Convention, parameters: DepthParameters) -> Depth:
    """The depth of a FluidPressure, or of the z of a PoseWithCovarianceStamped or an Odometry.

    Raises:
        RejectedMessage: ``bad_stamp``, ``no_stamp``, ``not_finite``, ``bad_covariance``; of a
            pressure ``no_data`` (it is zero), ``out_of_range`` (it is negative, of a sensor that
            measures the atmosphere as well) or ``in_air`` (shallower than depth.min_depth).
    """
    if hasattr(message, "fluid_pressure"):
        return _of_pressure(message, parameters)
    return _of_height(message, convention)


def _of_pressure(message: Any, parameters: DepthParameters) -> Depth:
    pressure, variance = float(message.fluid_pressure), float(message.variance)
    stamp = sensor_stamp_ns(message.header)
    if not math.isfinite(pressure):
        raise RejectedMessage("not_finite", f"fluid_pressure is {pressure}")
    if pressure == 0.0:
        raise RejectedMessage("no_data", "fluid_pressure is exactly 0")
    atmosphere = parameters.atmospheric_pressure
    if pressure < 0.0 < atmosphere:
        raise RejectedMessage(
            "out_of_range",
            f"fluid_pressure is {pressure:g} Pa; a gauge that does not measure the atmosphere "
            "needs depth.atmospheric_pressure 0",
        )
    weight = parameters.water_density * STANDARD_GRAVITY  # Pa per m
    below = (pressure - atmosphere) / weight
    if below < parameters.min_depth:
        raise RejectedMessage(
            "in_air",
            f"fluid_pressure {pressure:g} Pa is {below:.2f} m below the surface, less than "
            f"depth.min_depth ({parameters.min_depth:g} m): the sensor is out of the water, or the "
            f"unit is not Pa (as hPa it would be {(100 * pressure - atmosphere) / weight:.1f} m)",
        )
    return Depth(stamp, below, _variance(variance / weight**2), from_pressure=True)


def _of_height(message: Any, convention: Convention) -> Depth:
    z = float(message.pose.pose.position.z)
    covariance = message.pose.covariance
    stamp = sensor_stamp_ns(message.header)
    if not math.isfinite(z):
        raise RejectedMessage("not_finite", f"position.z is {z}")
    if len(covariance) != 36:
        raise RejectedMessage("bad_covariance", f"pose.covariance has {len(covariance)} elements")
    # Down is NED's z and the opposite of ENU's.
    return Depth(stamp, float(convention.nav[2, 2]) * z, _variance(float(covariance[_Z_VARIANCE])))


def _variance(value: float) -> float | None:
    """A variance; None where it is unknown, which 0 and -1 say.

    Raises:
        RejectedMessage: ``bad_covariance``.
    """
    if not math.isfinite(value):
        raise RejectedMessage("bad_covariance", f"the variance is {value}")
    return value if value > 0.0 else None
