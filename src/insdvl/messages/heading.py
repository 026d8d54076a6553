"""Heading, from the orientation of an IMU, of a pose or of a quaternion."""

from typing import Any

import numpy as np

from insdvl.arrays import Array
from insdvl.messages import convert
from insdvl.messages.convert import RejectedMessage, sensor_stamp_ns
from insdvl.navigation.geometry.frames import (
    CONVENTIONS,
    rotation_from_quaternion,
    rotation_from_rpy,
)
from insdvl.navigation.measurements.heading import Heading
from insdvl.navigation.parameters import FilterParameters

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
QUATERNION = "geometry_msgs/msg/QuaternionStamped"
#: Types that `heading` converts.
TYPES = (convert.IMU, POSE, QUATERNION)

#: Reasons for which it refuses a message.
REFUSALS = ("bad_stamp", "no_stamp", "not_finite", "bad_quaternion", "bad_covariance", "no_data")


def heading(message: Any, parameters: FilterParameters, mount: tuple[float, ...]) -> Heading:
    """The attitude of base_link in an Imu, a PoseWithCovarianceStamped or a QuaternionStamped.

    Args:
        message: The message.
        parameters: Of the filter.
        mount: Roll, pitch, yaw of the sensor in base_link [rad], in the axes of the parameters.

    Raises:
        RejectedMessage: ``bad_stamp``, ``no_stamp``, ``not_finite``, ``bad_quaternion``,
            ``bad_covariance``, or ``no_data`` where the first element of the covariance is -1.
    """
    convention = CONVENTIONS[parameters.frame_convention]
    stamp_ns, (q, covariance) = sensor_stamp_ns(message.header), _orientation(message)
    q_xyzw = np.array([q.x, q.y, q.z, q.w], dtype=float)
    if not np.isfinite(q_xyzw).all():
        raise RejectedMessage("not_finite", f"orientation is {q_xyzw.tolist()}")
    if not abs(np.hypot.reduce(q_xyzw) - 1.0) < 1e-2:
        raise RejectedMessage("bad_quaternion", f"orientation is {q_xyzw.tolist()}")
    C_n_s = convention.attitude(rotation_from_quaternion(q_xyzw))
    C_b_s = convention.body_rotation(rotation_from_rpy(np.array(mount)))
    to_true_north = rotation_from_rpy(np.array([0.0, 0.0, parameters.heading.declination]))
    P_psi = None if covariance is None else convention.nav @ covariance @ convention.nav.T
    return Heading(stamp_ns, np.ascontiguousarray(to_true_north @ C_n_s @ C_b_s.T), P_psi)


def _orientation(message: Any) -> tuple[Any, Array | None]:
    """Quaternion of a message, and covariance (3, 3) of the rotation in it; None where unknown."""
    if hasattr(message, "quaternion"):
        return message.quaternion, None
    if hasattr(message, "pose"):
        name = "pose.covariance"
        turns = convert.square(message.pose.covariance, 6, name)[3:, 3:]
        return message.pose.pose.orientation, convert.covariance(turns, 3, f"{name}[3:6, 3:6]")
    name = "orientation_covariance"
    told = convert.covariance(message.orientation_covariance, 3, name)
    return message.orientation, told
