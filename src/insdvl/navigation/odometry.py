"""The filter's output: odometry of base_link and biases, with covariances of ordinary errors."""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.kernels import kernel
from insdvl.navigation import error_state
from insdvl.navigation.channels import unseen_sigma
from insdvl.navigation.error_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYROSCOPE_BIAS,
    POSITION,
    VELOCITY,
)
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.geometry import earth, odom
from insdvl.navigation.geometry.rotation import (
    about_down,
    cross,
    product,
    product_transposed,
    quaternions,
    rotate,
    rotate_back,
    skew,
)
from insdvl.navigation.state import NEVER, State


@dataclass(frozen=True, slots=True)
class Odometry:
    """State of base_link at a stamp, in the axes of the stream's convention.

    Attributes:
        stamp_ns: Time of the state.
        position: (3,) in odom [m].
        quaternion_xyzw: (4,) attitude of base_link in odom, tilt against the local level.
        pose_covariance: (6, 6) of position and of the rotation about odom's axes [m, rad].
        twist_linear: (3,) velocity in body axes [m/s].
        twist_angular: (3,) turn rate against odom in body axes [rad/s].
        twist_covariance: (6, 6) of both, in body axes.
        place: (3,) latitude, longitude [rad] and height above the ellipsoid [m].
        place_covariance: (3, 3) of metres north, east and down at the vehicle [m^2].
    """

    stamp_ns: int
    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    twist_linear: Array
    twist_angular: Array
    twist_covariance: Array
    place: Array
    place_covariance: Array


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
_VELOCITY, _ATTITUDE, _HEADING, _GYROSCOPE_BIAS, _POSITION = (
    VELOCITY.start,
    ATTITUDE.start,
    ATTITUDE.stop - 1,
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
        ("place", "f8", (3,)),
        ("place_covariance", "f8", (3, 3)),
        ("local_covariance", "f8", (6, 6)),  # of the pose, in north, east, down at the vehicle
        ("origin", "f8", (3,)),
        ("to_odom", "f8", (6, 6)),
        ("J", "f8", (6, LAYOUT.size)),
        ("C", "f8", (1, 3, 3)),
        ("M1", "f8", (3, 3)),
        ("M2", "f8", (3, 3)),
        ("x1", "f8", (3,)),
        ("x2", "f8", (3,)),
    ],
    align=True,
)


def position_in_odom(nav: State) -> Array:
    """Position of the IMU in odom (..., 3) [m], as north, east, down, of groups ``nav`` (...)."""
    origin = np.stack([nav["lat_0"], nav["lon_0"], nav["h_0"]], axis=-1).reshape(-1, 3)[-1]
    p_o, _ = odom.in_odom(nav["llh"], origin)
    return p_o


def odometry(filter_: Filter, states: Records, k: int) -> Odometry:
    """Odometry of the state record ``states[k]``."""
    out = np.zeros(1, _OUTPUT)
    _odometry(states, k, filter_.constants, out)
    o = out[0]
    return Odometry(
        stamp_ns=int(states[k]["nav"]["time_ns"]),
        position=o["position"],
        quaternion_xyzw=o["quaternion_xyzw"][0],
        pose_covariance=o["pose_covariance"],
        twist_linear=o["twist_linear"],
        twist_angular=o["twist_angular"],
        twist_covariance=o["twist_covariance"],
        place=o["place"],
        place_covariance=o["place_covariance"],
    )


@kernel
def _odometry(states: Records, k: int, constants: Records, out: Records) -> None:
    """base_link lies at -l from the IMU: p = p_imu - C l, v_b = C_b_n v_imu - w_nb x l.

    With the errors of the model, dp_base = dp + [C l x] psi (less [x x] psi for `invariant`, x
    being the position of the IMU from the reference), and in body axes
    dv_base = C_b_n dv (+ C_b_n [v x] psi for `ned`) - [l x] (db_w + n),  dw_nb = -(db_w + n),
    where n is the white noise of the one sample that the turn rate is measured with, and what its
    saturated or frozen channels do not see.
    """
    s, c, o = states[k], constants[0], out[0]
    C, J, M, N, x, y = s.nav.C_n_b, o.J, o.M1, o.M2, o.x1, o.x2
    n = c.n

    # base_link's place, its position and the axes there against those of odom.
    rotate(x, C, c.l_b_imu)
    o.place[:] = s.nav.llh
    for i in range(3):
        y[i] = -x[i]
    earth.move(o.place, y)
    o.origin[0], o.origin[1], o.origin[2] = s.nav.lat_0, s.nav.lon_0, s.nav.h_0
    odom.position(y, o.place, o.origin)
    rotate(o.position, c.nav, y)
    odom.axes(M, o.place, o.origin)
    about_down(N, odom.convergence(M))
    product(o.C[0], c.nav, N)
    error_state.set_block(o.to_odom, 3, 3, 1.0, o.C[0])
    odom.convergence_slope(y, o.place, o.origin)
    for j in range(2):
        o.to_odom[5, j] = c.nav[2, 2] * y[j]
    odom.position_jacobian(N, M)
    product(M, c.nav, N)
    error_state.set_block(o.to_odom, 0, 0, 1.0, M)
    product(N, o.C[0], C)
    product(o.C[0], N, c.body)
    quaternions(o.quaternion_xyzw, o.C)

    if c.invariant:
        earth.displacement(y, s.nav.llh_r, s.nav.llh)
        for i in range(3):
            x[i] -= y[i]
    skew(M, x)
    error_state.set_block(J, 0, _ATTITUDE, 1.0, M)
    slope, of_sine, of_cosine = error_state.heading_moments(s.nav.P[_HEADING, _HEADING])
    if c.invariant:
        for i in range(3):
            J[i, _HEADING] *= slope
    for i in range(3):
        J[i, _POSITION + i] = 1.0
        J[3 + i, _ATTITUDE + i] = 1.0
    _congruence(o.local_covariance, J, s.nav.P, n)
    if c.invariant:
        _add_arc(o.local_covariance, x, of_sine, of_cosine)
    o.place_covariance[:] = o.local_covariance[:3, :3]
    _congruence(o.pose_covariance, o.to_odom, o.local_covariance, 6)

    rotate_back(x, C, s.nav.v_n)
    cross(y, s.nav.w_nb_b, c.l_b_imu)
    for i in range(3):
        x[i] -= y[i]
    rotate(o.twist_linear, c.body, x)
    rotate(o.twist_angular, c.body, s.nav.w_nb_b)
    J[:] = 0.0
    product_transposed(M, c.body, C)
    error_state.set_block(J, 0, _VELOCITY, 1.0, M)
    if not c.invariant:
        skew(N, s.nav.v_n)
        product(o.C[0], M, N)
        error_state.set_block(J, 0, _ATTITUDE, 1.0, o.C[0])
    skew(M, c.l_b_imu)
    product(N, c.body, M)
    error_state.set_block(J, 0, _GYROSCOPE_BIAS, -1.0, N)
    error_state.set_block(J, 3, _GYROSCOPE_BIAS, -1.0, c.body)
    _congruence(o.twist_covariance, J, s.nav.P, n)
    # The sample's noise, and what its channels do not see, enter as the gyroscope bias does.
    for a in range(3):
        for b in range(3):
            M[a, b] = c.density * c.rate * s.noise.Q_w[a, b]
            for i in range(3):
                if s.channels.unseen_ns[3 + i] != NEVER:
                    sigma = unseen_sigma(c, s.channels.reading, 3 + i)
                    M[a, b] += c.C_b_i[a, i] * sigma**2 * c.C_b_i[b, i]
    for i in range(6):
        for j in range(6):
            for a in range(3):
                for b in range(3):
                    o.twist_covariance[i, j] += (
                        J[i, _GYROSCOPE_BIAS + a] * M[a, b] * J[j, _GYROSCOPE_BIAS + b]
                    )
    for i in range(6):  # the sums of two mirrored elements are rounded in different orders
        for j in range(i):
            o.twist_covariance[j, i] = o.twist_covariance[i, j]


@kernel
def _add_arc(covariance: Array, x_n: Array, of_sine: float, of_cosine: float) -> None:
    """Complete the covariance (6, 6) of the pose by the second moments of an arc, horizontally.

    With a heading error h the true position lies at exp([h e_D x]) x from the reference: beside x
    by sin(h) x, of which the Jacobian has the line, and short of it by (1 - cos h) x.
    """
    beside_n = (-x_n[1], x_n[0])
    for i in range(2):
        for j in range(2):
            covariance[i, j] += of_cosine * x_n[i] * x_n[j] + of_sine * beside_n[i] * beside_n[j]


@kernel
def _congruence(out: Array, J: Array, P: Array, n: int) -> None:
    """out = J P J^T, (6, 6), exactly symmetric."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for a in range(n):
                if J[i, a] != 0.0:
                    for b in range(n):
                        total += J[i, a] * P[a, b] * J[j, b]
            out[i, j] = total
            out[j, i] = total


def biases(filter_: Filter, s: State) -> Biases:
    """Biases of a state record."""
    to_imu = filter_.vehicle.axes.body @ filter_.C_b_i.T
    nav = s["nav"]
    P = nav["P"]
    return Biases(
        stamp_ns=int(nav["time_ns"]),
        accelerometer=to_imu @ nav["b_f"],
        accelerometer_covariance=_symmetric(
            to_imu @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ to_imu.T
        ),
        gyroscope=to_imu @ nav["b_w"],
        gyroscope_covariance=_symmetric(to_imu @ P[GYROSCOPE_BIAS, GYROSCOPE_BIAS] @ to_imu.T),
    )


def _symmetric(P: Array) -> Array:
    return (P + P.T) / 2
