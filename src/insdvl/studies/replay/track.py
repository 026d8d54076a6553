"""The navigated track as columns: what the recording, track.csv and the report are made from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records, Stamps
from insdvl.messages.cdr.odometry_bytes import OdometryColumns
from insdvl.navigation.error_state import ACCELEROMETER_BIAS, GYROSCOPE_BIAS
from insdvl.navigation.events import NS
from insdvl.navigation.filter import Filter
from insdvl.navigation.geometry.frames import rotation_from_quaternion, rpy_from_rotation
from insdvl.navigation.odometry import Odometry, odometries

#: Part of an interval by which a state may be early: stamps are rounded.
_EARLY = 0.01


@dataclass(frozen=True)
class TrackColumns:
    """N states, in the axes of the stream.

    Attributes:
        stamps_ns: (N,) stamps.
        part: (N,) number of the part between time jumps, from 0.
        position: (N, 3) of base_link in map, which is odom where no absolute input is used [m].
        quaternion_xyzw: (N, 4) attitude of base_link in map.
        pose_covariance: (N, 6, 6) of both.
        odom_position, odom_quaternion_xyzw, odom_covariance: The same in odom.
        map_to_odom: (N, 4) position of odom in map [m] and yaw of its axes [rad].
        linear: (N, 3) velocity in body axes [m/s].
        angular: (N, 3) turn rate in body axes [rad/s].
        twist_covariance: (N, 6, 6) of both.
        place: (N, 3) latitude, longitude [rad] and height [m].
        place_covariance: (N, 3, 3) of metres north, east and down [m^2].
        accelerometer_bias: (N, 3) in IMU axes [m/s^2].
        accelerometer_bias_covariance: (N, 3, 3).
        gyroscope_bias: (N, 3) in IMU axes [rad/s].
        gyroscope_bias_covariance: (N, 3, 3).
        accelerometer_noise: (N, 3) one sigma per sample in effect, in body axes [m/s^2].
        gyroscope_noise: (N, 3) the same [rad/s].
    """

    stamps_ns: Stamps
    part: NDArray[np.int64]
    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    odom_position: Array
    odom_quaternion_xyzw: Array
    odom_covariance: Array
    map_to_odom: Array
    linear: Array
    angular: Array
    twist_covariance: Array
    place: Array
    place_covariance: Array
    accelerometer_bias: Array
    accelerometer_bias_covariance: Array
    gyroscope_bias: Array
    gyroscope_bias_covariance: Array
    accelerometer_noise: Array
    gyroscope_noise: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def rpy(self) -> Array:
        """(N, 3) roll, pitch and yaw [rad]."""
        return rpy_from_rotation(rotation_from_quaternion(self.quaternion_xyzw))

    @property
    def in_map(self) -> OdometryColumns:
        """The odometry in map."""
        return self._seen(self.position, self.quaternion_xyzw, self.pose_covariance)

    @property
    def in_odom(self) -> OdometryColumns:
        """The odometry in odom."""
        return self._seen(self.odom_position, self.odom_quaternion_xyzw, self.odom_covariance)

    def _seen(self, position: Array, quaternion_xyzw: Array, covariance: Array) -> OdometryColumns:
        twist = self.linear, self.angular, self.twist_covariance
        return OdometryColumns(self.stamps_ns, position, quaternion_xyzw, covariance, *twist)

    def odometry(self, k: int) -> Odometry:
        """The odometry of one state."""
        return Odometry(
            int(self.stamps_ns[k]),
            self.position[k],
            self.quaternion_xyzw[k],
            self.pose_covariance[k],
            self.odom_position[k],
            self.odom_quaternion_xyzw[k],
            self.odom_covariance[k],
            self.map_to_odom[k],
            self.linear[k],
            self.angular[k],
            self.twist_covariance[k],
            self.place[k],
            self.place_covariance[k],
        )


class Choice:
    """Which states are put out: the first of each interval, counted from the first state.

    Args:
        rate: States per second; 0 for all.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._start_ns: int | None = None
        self._interval = -1.0  # of the last state

    def of(self, stamps_ns: Stamps) -> NDArray[np.intp]:
        """Indices of those that are put out of the states that follow, stamps (N,)."""
        if self._start_ns is None:
            self._start_ns = int(stamps_ns[0])
        if self._rate == 0.0:
            return np.arange(len(stamps_ns))
        interval = ((stamps_ns - self._start_ns) * (self._rate / NS) + _EARLY) // 1.0
        firsts = np.diff(interval, prepend=self._interval) > 0
        self._interval = float(interval[-1])
        return np.flatnonzero(firsts)


def track_of(filter_: Filter, states: Records, ks: NDArray[np.intp], part: int) -> TrackColumns:
    """The columns of initialised states.

    Args:
        filter_: The filter.
        states: (N,) records.
        ks: (M,) indices of those that are wanted.
        part: Number of their part.
    """
    o, nav, noise = odometries(filter_, states, ks), states["nav"], states["noise"]
    axes = filter_.vehicle.axes.body
    to_imu = axes @ filter_.C_b_i.T

    def biases(name: str, block: slice) -> tuple[Array, Array]:
        P = to_imu @ nav["P"][:, block, block][ks] @ to_imu.T
        return nav[name][ks] @ to_imu.T, (P + P.transpose(0, 2, 1)) / 2

    def sigmas(name: str) -> Array:
        variances = np.diagonal(noise[name], axis1=1, axis2=2)[ks]
        return np.asarray(np.sqrt(np.abs(variances @ axes.T)))

    b_f, P_f = biases("b_f", ACCELEROMETER_BIAS)
    b_w, P_w = biases("b_w", GYROSCOPE_BIAS)
    return TrackColumns(
        stamps_ns=nav["time_ns"][ks],
        part=np.full(len(ks), part),
        position=o["position"],
        quaternion_xyzw=o["quaternion_xyzw"][:, 0],
        pose_covariance=o["pose_covariance"],
        odom_position=o["odom_position"],
        odom_quaternion_xyzw=o["odom_quaternion_xyzw"][:, 0],
        odom_covariance=o["odom_covariance"],
        map_to_odom=o["map_to_odom"],
        linear=o["twist_linear"],
        angular=o["twist_angular"],
        twist_covariance=o["twist_covariance"],
        place=o["place"],
        place_covariance=o["place_covariance"],
        accelerometer_bias=b_f,
        accelerometer_bias_covariance=P_f,
        gyroscope_bias=b_w,
        gyroscope_bias_covariance=P_w,
        accelerometer_noise=sigmas("Q_f"),
        gyroscope_noise=sigmas("Q_w"),
    )
