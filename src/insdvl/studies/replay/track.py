"""The navigated track as columns: what the recording, track.csv and the report are made from."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array, Stamps
from insdvl.messages.cdr.odometry_bytes import OdometryColumns
from insdvl.navigation.events import NS
from insdvl.navigation.odometry import Odometry, biases, odometry
from insdvl.studies.replay.fold import Replayed
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import FoldResult

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
        return np.asarray(Rotation.from_quat(self.quaternion_xyzw).as_euler("xyz"))

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


def chosen(part: Fold | FoldResult, rate: float) -> NDArray[np.intp]:
    """Indices of the states of a part that are put out.

    Args:
        part: What was folded.
        rate: States per second, the first of each interval; 0 for all.
    """
    known = np.flatnonzero(part.states["nav"]["initialised"])
    if rate == 0.0 or not known.size:
        return known
    stamps_ns = part.states["nav"]["time_ns"][known]
    interval = ((stamps_ns - stamps_ns[0]) * (rate / NS) + _EARLY) // 1.0
    firsts = np.diff(interval, prepend=interval[0] - 1) > 0
    firsts[-1] = True  # where it ended
    return np.asarray(known[firsts])


def track_of(replayed: Replayed, rate: float) -> TrackColumns:
    """The track of all parts.

    Args:
        replayed: The folded recording.
        rate: See `chosen`.
    """
    rows = [
        row
        for number, part in enumerate(replayed.parts)
        for row in _rows(part, number, chosen(part, rate))
    ]
    columns = zip(*rows, strict=True)
    return TrackColumns(*(np.array(column) for column in columns))


def _rows(
    part: Fold | FoldResult, number: int, indices: NDArray[np.intp]
) -> Iterator[tuple[object, ...]]:
    filter_, states = part.filter, part.states
    axes = filter_.vehicle.axes.body
    for k in indices.tolist():
        o = odometry(filter_, states, k)
        b = biases(filter_, states[k])
        noise = states[k]["noise"]
        yield (
            o.stamp_ns,
            number,
            o.position,
            o.quaternion_xyzw,
            o.pose_covariance,
            o.odom_position,
            o.odom_quaternion_xyzw,
            o.odom_covariance,
            o.map_to_odom,
            o.twist_linear,
            o.twist_angular,
            o.twist_covariance,
            o.place,
            o.place_covariance,
            b.accelerometer,
            b.accelerometer_covariance,
            b.gyroscope,
            b.gyroscope_covariance,
            np.sqrt(np.abs(axes @ np.diag(noise["Q_f"]))),
            np.sqrt(np.abs(axes @ np.diag(noise["Q_w"]))),
        )
