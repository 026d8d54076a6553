"""Numbers to ROS messages. rclpy does not check fields: what is assigned here is checked here.

A float field takes a Python float only (anything else arrives as garbage), a covariance a flat
float64 array of exactly its size.
"""

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray

from insdvl.events import NS

Array = NDArray[np.float64]


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


def upper_left(P: ArrayLike) -> Array:
    """A covariance (3, 3) as the linear block of a flat 6x6, the rest unknown (zeros)."""
    full = np.zeros((6, 6))
    full[:3, :3] = flat_covariance(P, 3).reshape(3, 3)
    return full.ravel()


def _floats(value: ArrayLike, size: int) -> list[float]:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{size} values were expected, got shape {array.shape}")
    return array.tolist()  # type: ignore[no-any-return]
