"""Numbers to the fields of standard messages, the counterpart of `convert`.

A message is any object with the fields of the standard type: an rclpy message, or one of a
recording. It is filled in place; frame ids are left as they are. rclpy does not check the values of
fields (any other number than a float arrives as garbage), so they are checked here.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU

#: Covariance of a quantity that a message does not carry (REP-145).
NOT_MEASURED = np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
#: Of a sensor_msgs/NavSatFix: STATUS_FIX, no satellite service, COVARIANCE_TYPE_KNOWN.
_HAS_FIX, _NO_SERVICE, _KNOWN = 0, 0, 3
#: Flat covariances that are not known, by the number of rows.
_UNKNOWN = {rows: np.zeros(rows * rows) for rows in (3, 6)}
for _shared in (NOT_MEASURED, *_UNKNOWN.values()):  # by all messages
    _shared.setflags(write=False)


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Set the stamp of a message with a header [ns]."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, NS)


def set_vector(field: Any, value: ArrayLike) -> None:
    """Assign (3,) to a Vector3 or Point.

    Raises:
        ValueError: The value has another shape.
    """
    field.x, field.y, field.z = _floats(value, 3)


def set_quaternion(field: Any, q_xyzw: ArrayLike) -> None:
    """Assign (4,) to a Quaternion.

    Raises:
        ValueError: The value has another shape.
    """
    field.x, field.y, field.z, field.w = _floats(q_xyzw, 4)


def flat_covariance(P: ArrayLike | None, rows: int) -> Array:
    """A covariance (rows, rows), or flat, as the flat array of a message; zeros where it is None.

    Raises:
        ValueError: The value has another size.
    """
    if P is None:
        return _UNKNOWN[rows]
    flat = np.ascontiguousarray(P, dtype=np.float64).ravel()
    if flat.size != rows * rows:
        raise ValueError(f"a covariance must have {rows * rows} values, got {flat.size}")
    return flat


def fill_imu(
    message: Any,
    stamp_ns: int,
    f: ArrayLike,
    w: ArrayLike,
    Q_f: ArrayLike | None = None,
    Q_w: ArrayLike | None = None,
) -> None:
    """Fill a sensor_msgs/Imu without orientation (REP-145).

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        f: (3,) specific force [m/s^2].
        w: (3,) angular rate [rad/s].
        Q_f: (3, 3) covariance of `f` [(m/s^2)^2], None for unknown.
        Q_w: (3, 3) covariance of `w` [(rad/s)^2], None for unknown.
    """
    set_stamp(message, stamp_ns)
    set_vector(message.linear_acceleration, f)
    message.linear_acceleration_covariance = flat_covariance(Q_f, 3)
    set_vector(message.angular_velocity, w)
    message.angular_velocity_covariance = flat_covariance(Q_w, 3)
    message.orientation_covariance = NOT_MEASURED


def fill_orientation(message: Any, stamp_ns: int, q_xyzw: ArrayLike, P_psi: ArrayLike) -> None:
    """Fill a sensor_msgs/Imu with an orientation alone (REP-145).

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        q_xyzw: (4,) quaternion.
        P_psi: (3, 3) covariance of the rotation [rad^2].
    """
    set_stamp(message, stamp_ns)
    set_quaternion(message.orientation, q_xyzw)
    message.orientation_covariance = flat_covariance(P_psi, 3)
    message.linear_acceleration_covariance = NOT_MEASURED
    message.angular_velocity_covariance = NOT_MEASURED


def fill_variances(message: Any, variances: Sequence[float] | Array) -> None:
    """Set the covariances of a sensor_msgs/Imu from variances (6,) of its channels, f then w."""
    message.linear_acceleration_covariance = flat_covariance(np.diag(variances[:3]), 3)
    message.angular_velocity_covariance = flat_covariance(np.diag(variances[3:]), 3)


def fill_twist(message: Any, stamp_ns: int, v: ArrayLike, R: ArrayLike | None = None) -> None:
    """Fill a geometry_msgs/TwistStamped, with a covariance a TwistWithCovarianceStamped.

    The angular part stays zero, and its covariance unknown.

    Args:
        message: The message; its type goes with `R`.
        stamp_ns: Stamp [ns].
        v: (3,) linear velocity [m/s].
        R: (3, 3) covariance of `v` [(m/s)^2].
    """
    set_stamp(message, stamp_ns)
    if R is None:
        set_vector(message.twist.linear, v)
        return
    set_vector(message.twist.twist.linear, v)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = R
    message.twist.covariance = covariance.ravel()


def fill_pressure(message: Any, stamp_ns: int, pressure: float, variance: float = 0.0) -> None:
    """Fill a sensor_msgs/FluidPressure.

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        pressure: [Pa].
        variance: [Pa^2], 0 for unknown.
    """
    set_stamp(message, stamp_ns)
    message.fluid_pressure, message.variance = float(pressure), float(variance)


def fill_odometry(
    message: Any,
    stamp_ns: int,
    position: ArrayLike,
    quaternion_xyzw: ArrayLike,
    linear: ArrayLike,
    angular: ArrayLike,
    pose_covariance: ArrayLike | None = None,
    twist_covariance: ArrayLike | None = None,
) -> None:
    """Fill a nav_msgs/Odometry (REP-105).

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        position: (3,) of the child in the frame [m].
        quaternion_xyzw: (4,) attitude of the child in the frame.
        linear: (3,) velocity in the child's axes [m/s].
        angular: (3,) angular rate in the child's axes [rad/s].
        pose_covariance: (6, 6) or (36,) of position and rotation, None for unknown.
        twist_covariance: (6, 6) or (36,) of `linear` and `angular`, None for unknown.
    """
    set_stamp(message, stamp_ns)
    set_vector(message.pose.pose.position, position)
    set_quaternion(message.pose.pose.orientation, quaternion_xyzw)
    message.pose.covariance = flat_covariance(pose_covariance, 6)
    set_vector(message.twist.twist.linear, linear)
    set_vector(message.twist.twist.angular, angular)
    message.twist.covariance = flat_covariance(twist_covariance, 6)


def fill_transform(
    message: Any, stamp_ns: int, position: ArrayLike, quaternion_xyzw: ArrayLike
) -> None:
    """Fill a geometry_msgs/TransformStamped.

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        position: (3,) of the child in the parent [m].
        quaternion_xyzw: (4,) attitude of the child in the parent.
    """
    set_stamp(message, stamp_ns)
    set_vector(message.transform.translation, position)
    set_quaternion(message.transform.rotation, quaternion_xyzw)


def fill_fix(message: Any, stamp_ns: int, place: Array, covariance: Array) -> None:
    """Fill a sensor_msgs/NavSatFix with a filter's estimate.

    Its status is a fix (0): the position is there to be used, and -1 would have every consumer
    discard it. It names no satellite service (0), since no receiver is behind it.

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        place: (3,) latitude, longitude [rad] and height above the ellipsoid [m].
        covariance: (3, 3) of metres north, east and down [m^2]; the message has east, north, up.
    """
    set_stamp(message, stamp_ns)
    message.status.status, message.status.service = _HAS_FIX, _NO_SERVICE
    message.latitude, message.longitude = np.degrees(place[:2]).tolist()
    message.altitude = float(place[2])
    message.position_covariance = (ENU.nav @ covariance @ ENU.nav.T).ravel()
    message.position_covariance_type = _KNOWN


def fill_innovation(
    message: Any, stamp_ns: int, innovation: Array, S: Array, *, angles: bool = False
) -> None:
    """Fill a geometry_msgs/TwistWithCovarianceStamped with the innovation of a measurement.

    Its rows are the last axes of the linear part, of a turn those of the angular one: a single row
    is along or about z. All else is zero. A component that was not measured has an infinite
    variance.

    Args:
        message: The message.
        stamp_ns: Stamp [ns].
        innovation: (m,) measured minus predicted, in the axes of the stream, with m <= 3.
        S: (m, m) its covariance.
        angles: Whether the rows are turns.
    """
    end = 6 if angles else 3
    at = slice(end - innovation.size, end)
    rows, covariance = np.zeros(6), np.zeros((6, 6))
    rows[at], covariance[at, at] = innovation, S
    set_stamp(message, stamp_ns)
    set_vector(message.twist.twist.linear, rows[:3])
    set_vector(message.twist.twist.angular, rows[3:])
    message.twist.covariance = covariance.ravel()


def _floats(value: ArrayLike, size: int) -> list[float]:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{size} values are required, got shape {array.shape}")
    values: list[float] = array.tolist()
    return values
