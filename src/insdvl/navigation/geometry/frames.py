"""Frame conventions: ENU/FLU (ROS, REP-103) and NED/FRD (the core). The only place that knows both.

Navigation axes: east-north-up and north-east-down. Body axes: forward-left-up and
forward-right-down. Both changes of axes are their own inverse, so one function serves both
directions, and a stream that already is NED/FRD passes through ``NED`` unchanged.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array
from insdvl.navigation.geometry.rotation import quaternions


@dataclass(frozen=True)
class Convention:
    """Axes of a stream, as rotations from and to the core's NED and FRD.

    Attributes:
        nav: (3, 3) rotation between the stream's navigation axes and NED; its own inverse.
        body: (3, 3) rotation between the stream's body axes and FRD; its own inverse.
    """

    nav: Array
    body: Array

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
    return Rotation.from_euler("xyz", rpy).as_matrix()


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
    """Rotation (3, 3) from a quaternion (x, y, z, w); it is normalised, zero is a ValueError."""
    return Rotation.from_quat(q_xyzw).as_matrix()


def quaternion_from_rotation(C: Array) -> Array:
    """Quaternions (..., 4) as (x, y, z, w), with w >= 0, of rotations (..., 3, 3)."""
    q_xyzw = np.empty((*C.shape[:-2], 4))
    quaternions(q_xyzw.reshape(-1, 4), np.ascontiguousarray(C).reshape(-1, 3, 3))
    return q_xyzw
