"""The filter's output: odometry of base_link and the biases, with covariances of ordinary errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl import error_state
from insdvl.error_state import ACCELEROMETER_BIAS, ATTITUDE, GYROSCOPE_BIAS, POSITION, VELOCITY
from insdvl.filter import Filter
from insdvl.frames import CONVENTIONS
from insdvl.kernels import kernel
from insdvl.rotation import (
    cross,
    product,
    product_transposed,
    quaternions,
    rotate,
    rotate_back,
    skew,
)
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


# First elements of the blocks, for the kernel.
_VELOCITY, _ATTITUDE, _GYROSCOPE_BIAS, _POSITION = (
    VELOCITY.start,
    ATTITUDE.start,
    GYROSCOPE_BIAS.start,
    POSITION.start,
)

#: Numbers of an `Odometry`, in one record that the kernel fills.
_OUTPUT = np.dtype(
    [
        ("position", "f8", (3,)),
        ("quaternion_xyzw", "f8", (1, 4)),
        ("pose_covariance", "f8", (6, 6)),
        ("twist_linear", "f8", (3,)),
        ("twist_angular", "f8", (3,)),
        ("twist_covariance", "f8", (6, 6)),
        ("J", "f8", (6, 18)),
        ("C", "f8", (1, 3, 3)),
        ("M1", "f8", (3, 3)),
        ("M2", "f8", (3, 3)),
        ("x1", "f8", (3,)),
        ("x2", "f8", (3,)),
    ],
    align=True,
)


def odometry(filter_: Filter, s: State) -> Odometry:
    """Odometry of a state record.

    base_link lies at -l from the IMU (l its lever arm): p = p_imu - C l, v_b = v_b,imu - w_nb x l.
    """
    axes = CONVENTIONS[filter_.parameters.frame_convention]
    vectors = np.empty((3, 3))
    quaternion_xyzw = np.empty(4)
    covariances = np.empty((2, 6, 6))
    _odometry(
        s,
        filter_.invariant,
        filter_.l_b_imu,
        axes.nav,
        axes.body,
        filter_.sample_variance_w(s),
        vectors,
        quaternion_xyzw,
        covariances,
    )
    return Odometry(
        stamp_ns=int(s["time_ns"]),
        position=vectors[0],
        quaternion_xyzw=quaternion_xyzw,
        pose_covariance=covariances[0],
        twist_linear=vectors[1],
        twist_angular=vectors[2],
        twist_covariance=covariances[1],
    )


@kernel
def _odometry(
    s: State,
    invariant: bool,
    l_b: Array,
    nav: Array,
    body: Array,
    sample: Array,
    vectors: Array,
    quaternion_xyzw: Array,
    covariances: Array,
) -> None:
    """Position, velocity and turn rate into the rows of ``vectors``; pose and twist covariance.

    In body axes, with the ordinary errors psi and dp of the state, to first order:

        dp_base = dp + [C l x] psi
        dv_b    = C_b_n dv (+ C_b_n [v x] psi for `ned`) - [l x] db_w
        dw_b    = -db_w

    The turn rate is that of one sample, whose own noise (``sample``, its variance) is white and not
    in P; it adds [l x] noise to the velocity.
    """
    n = s.P.shape[0]
    C = s.C_n_b
    l_x, arm_x, v_x, A, B = (
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )
    arm, x = np.empty(3), np.empty(3)
    rotate(arm, C, l_b)
    skew(l_x, l_b)
    skew(arm_x, arm)
    skew(v_x, s.v_n)

    for i in range(3):
        x[i] = s.p_n[i] - arm[i]
    rotate(vectors[0], nav, x)
    rotate_back(x, C, s.v_n)
    rotate(arm, l_x, s.w_nb_b)  # l x w = -(w x l)
    for i in range(3):
        x[i] += arm[i]
    rotate(vectors[1], body, x)
    rotate(vectors[2], body, s.w_nb_b)
    product(A, nav, C)
    product(B, A, body)
    quaternion(quaternion_xyzw, B)

    J = np.zeros((2, 6, n))
    product(A, nav, arm_x)
    for i in range(3):
        for j in range(3):
            J[0, i, 12 + j] = nav[i, j]
            J[0, i, 3 + j] = A[i, j]
            J[0, 3 + i, 3 + j] = nav[i, j]
    product_transposed(A, body, C)
    for i in range(3):
        for j in range(3):
            J[1, i, j] = A[i, j]
            J[1, 3 + i, 9 + j] = -body[i, j]
    if not invariant:
        product(B, A, v_x)
        J[1, 0:3, 3:6] = B
    product(B, body, l_x)
    for i in range(3):
        for j in range(3):
            J[1, i, 9 + j] = -B[i, j]
    for m in range(2):
        _congruence(covariances[m], J[m], s.P)

    white = np.empty((6, 3))
    white[0:3] = B
    white[3:6] = body
    noise = np.empty((6, 6))
    _congruence(noise, white, sample)
    covariances[1] += noise


@kernel
def _congruence(out: Array, J: Array, P: Array) -> None:
    """out = J P J^T, exactly symmetric, leaving out the zeros of J."""
    rows, n = J.shape
    JP = np.zeros((rows, n))
    for i in range(rows):
        for k in range(n):
            if J[i, k] != 0.0:
                for j in range(n):
                    JP[i, j] += J[i, k] * P[k, j]
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += JP[i, k] * J[j, k]
            out[i, j] = total
            out[j, i] = total


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
