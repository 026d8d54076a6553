"""Frame conventions: ENU/FLU (ROS, REP-103) and NED/FRD (the core). The only place that knows both.

Navigation axes: east-north-up and north-east-down. Body axes: forward-left-up and
forward-right-down. Both changes of axes are their own inverse, so one function serves both
directions, and a stream that already is NED/FRD passes through ``NED`` unchanged.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.geometry.rotation import quaternions, rotations, rotations_of_quaternions


@dataclass(frozen=True)
class Convention:
    """Axes of a stream, as rotations from and to the core's NED and FRD.

    Attributes:
        nav: (3, 3) rotation between the stream's navigation axes and NED; its own inverse.
        body: (3, 3) rotation between the stream's body axes and FRD; its own inverse.
    """

    nav: Array
    body: Array

    @cached_property
    def signs(self) -> Array:
        """(3,) diagonal of ``body``, which has nothing else."""
        return np.diagonal(self.body).copy()

    def attitude(self, C: Array) -> Array:
        """Body-to-navigation rotation (3, 3) from the one convention in the other."""
        return self.nav @ C @ self.body

    def body_rotation(self, C: Array) -> Array:
        """Rotation (3, 3) between two body-fixed frames (a sensor's mount) in the other axes."""
        return self.body @ C @ self.body


ENU = Convention(
    nav=np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    body=np.diag([1.0, -1.0, -1.0]),
)
NED = Convention(nav=np.eye(3), body=np.eye(3))
CONVENTIONS = {"enu": ENU, "ned": NED}


def rotation_from_rpy(rpy: Array) -> Array:
    """Rotation (3, 3) from roll, pitch, yaw [rad]: R = Rz(yaw) Ry(pitch) Rx(roll) (REP-103)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(C: Array) -> Array:
    """Roll, pitch, yaw [rad], shape (..., 3), of rotations (..., 3, 3).

    At pitch +-90 deg roll and yaw are not separate; yaw is then undefined and only their sum or
    difference is kept.
    """
    roll = np.arctan2(C[..., 2, 1], C[..., 2, 2])
    pitch = -np.arcsin(np.clip(C[..., 2, 0], -1.0, 1.0))  # rounding may leave 1 by one ulp
    yaw = np.arctan2(C[..., 1, 0], C[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def rotation_from_quaternion(q_xyzw: Array) -> Array:
    """Rotations (..., 3, 3) from quaternions (..., 4) as (x, y, z, w), which are normalised.

    Raises:
        ValueError: One is zero.
    """
    q = np.ascontiguousarray(q_xyzw, dtype=np.float64)
    C = np.empty((*q.shape[:-1], 3, 3))
    if not rotations_of_quaternions(C.reshape(-1, 3, 3), q.reshape(-1, 4)):
        raise ValueError("a quaternion must not have zero norm")
    return C


def quaternion_from_rotation(C: Array) -> Array:
    """Quaternions (..., 4) as (x, y, z, w), with w >= 0, of rotations (..., 3, 3)."""
    q_xyzw = np.empty((*C.shape[:-2], 4))
    quaternions(q_xyzw.reshape(-1, 4), np.ascontiguousarray(C).reshape(-1, 3, 3))
    return q_xyzw


def rotation_from_vector(phi: Array) -> Array:
    """Rotations exp([phi x]) (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    C = np.empty((*np.shape(phi), 3))
    rotations(C.reshape(-1, 3, 3), np.ascontiguousarray(phi, dtype=np.float64).reshape(-1, 3))
    return C


def vector_from_rotation(C: Array) -> Array:
    """Rotation vectors (..., 3) [rad], of at most pi, of rotations (..., 3, 3)."""
    q_xyzw = quaternion_from_rotation(C)
    sine = np.linalg.norm(q_xyzw[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q_xyzw[..., 3:])
    scale = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)
    return scale * q_xyzw[..., :3]
