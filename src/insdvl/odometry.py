"""The filter's output: odometry of base_link and the biases, with covariances of ordinary errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl import error_state
from insdvl.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS, POSITION
from insdvl.filter import Filter
from insdvl.frames import CONVENTIONS, quaternion_from_rotation
from insdvl.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Odometry:
    """State of base_link at a stamp, in the axes of the stream's convention.

    Attributes:
        stamp_ns: Time of the state.
        position: (3,) in odom [m].
        quaternion_xyzw: (4,) attitude of base_link in odom.
        pose_covariance: (6, 6) of position and of the rotation about odom's axes [m, rad].
        twist_linear: (3,) velocity in body axes [m/s].
        twist_angular: (3,) turn rate against odom in body axes [rad/s].
        twist_covariance: (6, 6) of both, in body axes.
    """

    stamp_ns: int
    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    twist_linear: Array
    twist_angular: Array
    twist_covariance: Array


@dataclass(frozen=True, slots=True)
class Biases:
    """Estimated sensor biases, in the axes of the IMU as it is in the stream's convention.

    Attributes:
        stamp_ns: Time of the state.
        accelerometer: (3,) [m/s^2], with its covariance (3, 3).
        gyroscope: (3,) [rad/s], with its covariance (3, 3).
    """

    stamp_ns: int
    accelerometer: Array
    accelerometer_covariance: Array
    gyroscope: Array
    gyroscope_covariance: Array


def odometry(filter_: Filter, s: State) -> Odometry:
    """Odometry of a state record.

    base_link lies at -l from the IMU (l its lever arm): p = p_imu - C l, v_b = v_b,imu - w_nb x l.
    """
    axes = CONVENTIONS[filter_.parameters.frame_convention]
    C, P, n = s["C_n_b"], s["P"], filter_.n
    l_b, w_nb_b = filter_.l_b_imu, s["w_nb_b"]
    l_x = error_state.cross_matrix(l_b)

    to_pose = np.zeros((6, n))
    to_pose[0:3, POSITION] = axes.nav
    to_pose[0:3, ATTITUDE] = axes.nav @ error_state.cross_matrix(C @ l_b)
    to_pose[3:6, ATTITUDE] = axes.nav
    to_twist = np.zeros((6, n))
    to_twist[0:3] = axes.body @ error_state.body_velocity_jacobian(
        C, s["v_n"], invariant=filter_.invariant, n=n
    )
    to_twist[0:3, GYROSCOPE_BIAS] = -axes.body @ l_x
    to_twist[3:6, GYROSCOPE_BIAS] = -axes.body

    # The turn rate is that of one sample, whose own noise is white and not in P.
    sample = filter_.sample_variance_w(s)
    from_sample = np.vstack([axes.body @ l_x, axes.body])
    return Odometry(
        stamp_ns=int(s["time_ns"]),
        position=axes.nav @ (s["p_n"] - C @ l_b),
        quaternion_xyzw=quaternion_from_rotation(axes.attitude(C)),
        pose_covariance=_symmetric(to_pose @ P @ to_pose.T),
        twist_linear=axes.body @ (C.T @ s["v_n"] - np.cross(w_nb_b, l_b)),
        twist_angular=axes.body @ w_nb_b,
        twist_covariance=_symmetric(
            to_twist @ P @ to_twist.T + from_sample @ sample @ from_sample.T
        ),
    )


def biases(filter_: Filter, s: State) -> Biases:
    """Biases of a state record."""
    axes = CONVENTIONS[filter_.parameters.frame_convention]
    to_imu = axes.body @ filter_.C_b_i.T
    P = s["P"]
    return Biases(
        stamp_ns=int(s["time_ns"]),
        accelerometer=to_imu @ s["b_f"],
        accelerometer_covariance=_symmetric(
            to_imu @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ to_imu.T
        ),
        gyroscope=to_imu @ s["b_w"],
        gyroscope_covariance=_symmetric(to_imu @ P[GYROSCOPE_BIAS, GYROSCOPE_BIAS] @ to_imu.T),
    )


def _symmetric(P: Array) -> Array:
    return (P + P.T) / 2
