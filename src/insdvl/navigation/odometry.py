"""The filter's output: odometry of base_link and biases, with covariances of ordinary errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    copy_matrix,
    copy_vector,
    cross,
    product,
    product_transposed,
    quaternions,
    rotate,
    rotate_back,
    skew,
)
from insdvl.navigation.state.fields import NEVER, State
from insdvl.navigation.state.scratch import Constants


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of base_link in a frame, in the axes of the stream's convention.

    Attributes:
        position: (3,) [m].
        quaternion_xyzw: (4,) attitude, tilt against the local level.
        covariance: (6, 6) of position and of the rotation about the frame's axes [m, rad].
    """

    position: Array
    quaternion_xyzw: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class Odometry:
    """State of base_link at a stamp, in the axes of the stream's convention.

    Attributes:
        stamp_ns: Time of the state.
        position: (3,) in map [m]; map is odom where no absolute input is used.
        quaternion_xyzw: (4,) attitude of base_link in map, tilt against the local level.
        pose_covariance: (6, 6) of position and of the rotation about map's axes [m, rad].
        odom_position, odom_quaternion_xyzw, odom_covariance: The same pose seen in odom.
        map_to_odom: (4,) position of odom in map [m] and yaw of its axes [rad].
        twist_linear: (3,) velocity in body axes [m/s].
        twist_angular: (3,) turn rate against map and odom in body axes [rad/s].
        twist_covariance: (6, 6) of both, in body axes.
        place: (3,) latitude, longitude [rad] and height above the ellipsoid [m].
        place_covariance: (3, 3) of metres north, east and down at the vehicle [m^2].
    """

    stamp_ns: int
    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    odom_position: Array
    odom_quaternion_xyzw: Array
    odom_covariance: Array
    map_to_odom: Array
    twist_linear: Array
    twist_angular: Array
    twist_covariance: Array
    place: Array
    place_covariance: Array

    @property
    def in_map(self) -> Pose:
        """The pose in map."""
        return Pose(self.position, self.quaternion_xyzw, self.pose_covariance)

    @property
    def in_odom(self) -> Pose:
        """The same pose in odom."""
        return Pose(self.odom_position, self.odom_quaternion_xyzw, self.odom_covariance)


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
        ("odom_position", "f8", (3,)),
        ("odom_quaternion_xyzw", "f8", (1, 4)),
        ("odom_covariance", "f8", (6, 6)),
        ("map_to_odom", "f8", (4,)),
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
    """Position of the IMU in map (..., 3) [m], as north, east, down, of groups ``nav`` (...)."""
    origin = np.stack([nav["lat_0"], nav["lon_0"], nav["h_0"]], axis=-1).reshape(-1, 3)[-1]
    p_o, _ = odom.in_odom(nav["llh"], origin)
    return p_o


def odometry(filter_: Filter, states: Records, k: int) -> Odometry:
    """Odometry of the state record ``states[k]``: the estimate, and as it is seen in odom."""
    out = np.zeros(1, _OUTPUT)
    _odometry(states, k, filter_.constants, out)
    o = out[0]
    return Odometry(
        stamp_ns=int(states[k]["nav"]["time_ns"]),
        position=o["position"],
        quaternion_xyzw=o["quaternion_xyzw"][0],
        pose_covariance=o["pose_covariance"],
        odom_position=o["odom_position"],
        odom_quaternion_xyzw=o["odom_quaternion_xyzw"][0],
        odom_covariance=o["odom_covariance"],
        map_to_odom=o["map_to_odom"],
        twist_linear=o["twist_linear"],
        twist_angular=o["twist_angular"],
        twist_covariance=o["twist_covariance"],
        place=o["place"],
        place_covariance=o["place_covariance"],
    )


def odometries(filter_: Filter, states: Records, ks: NDArray[np.intp]) -> Records:
    """Odometry of the state records ``states[ks]`` (M,) as records.

    Their fields are those of `Odometry`, beside scratch memory; ``quaternion_xyzw`` and
    ``odom_quaternion_xyzw`` are (M, 1, 4).
    """
    out = np.zeros(len(ks), _OUTPUT)
    _odometries(states, ks, filter_.constants, out)
    return out


@kernel
def _odometries(states: Records, ks: NDArray[np.intp], constants: Records, out: Records) -> None:
    for m in range(len(ks)):
        _odometry(states, ks[m], constants, out[m : m + 1])


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
    copy_vector(o.place, s.nav.llh)
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
    copy_matrix(o.place_covariance, o.local_covariance)
    _congruence(o.pose_covariance, o.to_odom, o.local_covariance, 6)
    _see_in_odom(s, c, o)

    J[:] = 0.0
    rotate_back(x, C, s.nav.v_n)
    cross(y, s.nav.w_nb_b, c.l_b_imu)
    for i in range(3):
        x[i] -= y[i]
    rotate(o.twist_linear, c.body, x)
    rotate(o.twist_angular, c.body, s.nav.w_nb_b)
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
def _see_in_odom(s: State, c: Constants, o: State) -> None:
    """The pose in odom, and its covariance: that by P and that of what was corrected.

    b_o is the way from the start in odom, where no absolute input moves it: the turn of the heading
    about the start has the variance of both. See map_to_odom.py.
    """
    m, C = s.odom, s.nav.C_n_b
    for i in range(3):
        o.map_to_odom[i] = 0.0
        for j in range(3):
            o.map_to_odom[i] += c.nav[i, j] * m.p[j]
    o.map_to_odom[3] = c.nav[2, 2] * m.yaw
    moved = m.yaw != 0.0
    for i in range(3):
        moved = moved or m.p[i] != 0.0
    for i in range(4):
        moved = moved or m.P[i, i] > 0.0
    if not moved:
        copy_vector(o.odom_position, o.position)
        copy_vector(o.odom_quaternion_xyzw, o.quaternion_xyzw)
        copy_matrix(o.odom_covariance, o.pose_covariance)
        return
    A, M, N = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    to_odom, J, D = o.to_odom, o.J, np.zeros((6, 6))
    p_o, b, b_o, x = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    rotate_back(x, c.nav, o.position)
    for i in range(3):
        x[i] -= m.p[i]
    about_down(N, -m.yaw)
    rotate(p_o, N, x)
    rotate(o.odom_position, c.nav, p_o)
    odom.axes(M, o.place, o.origin)
    about_down(A, odom.convergence(M) - m.yaw)

    # In north, east, down at the vehicle; to_odom leads from there to odom's axes.
    odom.position_jacobian(o.M1, M)
    product(M, N, o.M1)
    product(N, c.nav, M)
    error_state.set_block(to_odom, 0, 0, 1.0, N)
    product(N, c.nav, A)
    error_state.set_block(to_odom, 3, 3, 1.0, N)
    product(M, N, C)
    product(o.C[0], M, c.body)
    quaternions(o.odom_quaternion_xyzw, o.C)

    for i in range(3):
        x[i] = p_o[i] - m.reference[i]
    rotate_back(b_o, A, x)
    skew(N, b_o)
    rotate(b, C, c.l_b_imu)
    if c.invariant:
        earth.displacement(x, s.nav.llh_r, s.nav.llh)
        for i in range(3):
            b[i] -= x[i]
    skew(M, b)
    slope, of_sine, of_cosine = 1.0, 0.0, 0.0
    if c.invariant:
        slope, of_sine, of_cosine = error_state.heading_moments(
            s.nav.P[_HEADING, _HEADING] + m.P[3, 3]
        )
    J[:] = 0.0
    for i in range(3):
        for j in range(3):
            J[i, _ATTITUDE + j] = M[i, j]
        J[i, _HEADING] += (1.0 - slope) * N[i, 2]
        J[i, _POSITION + i] = 1.0
        J[3 + i, _ATTITUDE + i] = 1.0
    _congruence(o.local_covariance, J, s.nav.P, c.n)
    # What was corrected, in odom's axes, as (position, 0, 0, yaw).
    for i in range(4):
        for j in range(4):
            D[i + 2 * (i == 3), j + 2 * (j == 3)] = m.P[i, j]
    J[:] = 0.0
    for i in range(3):
        for j in range(3):
            J[i, j] = A[j, i]
        J[i, 5] = -N[i, 2] * slope
    J[5, 5] = 1.0
    _congruence(o.odom_covariance, J, D, 6)
    for i in range(6):
        for j in range(6):
            o.local_covariance[i, j] += o.odom_covariance[i, j]
    _add_arc(o.local_covariance, b_o, of_sine, of_cosine)
    _congruence(o.odom_covariance, to_odom, o.local_covariance, 6)


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
