"""Numbers to ROS messages. rclpy does not check fields: what is assigned here is checked here.

A float field takes a Python float only (anything else arrives as garbage), a covariance a flat
float64 array of exactly its size.
"""

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import Imu

from insdvl.navigation.events import NS
from insdvl.navigation.odometry import Biases
from insdvl.navigation.odometry import Odometry as FilterOdometry

Array = NDArray[np.float64]

#: Covariance of a quantity that a message does not carry (REP-145).
NOT_MEASURED = np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def time_of(stamp_ns: int) -> Time:
    """Integer nanoseconds as a stamp."""
    return Time(sec=stamp_ns // NS, nanosec=stamp_ns % NS)


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


def flat_covariance(P: ArrayLike, rows: int) -> Array:
    """A covariance (rows, rows), or flat, as the flat array that a message takes.

    Raises:
        ValueError: The value has another size.
    """
    flat = np.ascontiguousarray(P, dtype=np.float64).ravel()
    if flat.size != rows * rows:
        raise ValueError(f"a covariance of {rows * rows} values was expected, got {flat.size}")
    return flat


def fill_odometry(message: Odometry, output: FilterOdometry) -> None:
    """The filter's state into an odometry message; frame ids are left as they are."""
    message.header.stamp = time_of(output.stamp_ns)
    set_vector(message.pose.pose.position, output.position)
    set_quaternion(message.pose.pose.orientation, output.quaternion_xyzw)
    message.pose.covariance = flat_covariance(output.pose_covariance, 6)
    set_vector(message.twist.twist.linear, output.twist_linear)
    set_vector(message.twist.twist.angular, output.twist_angular)
    message.twist.covariance = flat_covariance(output.twist_covariance, 6)


def fill_bias(message: Imu, output: Biases) -> None:
    """The estimated biases, each in the fields of its sensor; there is no orientation (REP-145)."""
    message.header.stamp = time_of(output.stamp_ns)
    set_vector(message.linear_acceleration, output.accelerometer)
    message.linear_acceleration_covariance = flat_covariance(output.accelerometer_covariance, 3)
    set_vector(message.angular_velocity, output.gyroscope)
    message.angular_velocity_covariance = flat_covariance(output.gyroscope_covariance, 3)
    message.orientation_covariance = NOT_MEASURED


def fill_innovation(
    message: TwistWithCovarianceStamped, stamp_ns: int, innovation: Array, S: Array
) -> None:
    """A DVL innovation (3,) and its covariance (3, 3); the angular part is unknown (zeros)."""
    message.header.stamp = time_of(stamp_ns)
    set_vector(message.twist.twist.linear, innovation)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = S
    message.twist.covariance = covariance.ravel()


def _floats(value: ArrayLike, size: int) -> list[float]:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{size} values were expected, got shape {array.shape}")
    return list(array.tolist())
