"""nav_msgs/Odometry as bytes, one message or many at once.

The layout in CDR is fixed but for the two frames, which are the same in all messages of a topic:
encapsulation, stamp, frame_id, child_frame_id (its length at a multiple of four bytes), and from
the next multiple of eight on 85 doubles. A general encoder takes 360 us for a message (`rosbags`),
or 40 us with the objects that rclpy wants for it.
"""

from collections.abc import Iterator
from struct import Struct
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.messages.cdr.layout import ENCAPSULATION, encoded_text
from insdvl.navigation.events import NS

_STAMP = Struct("<iI")
_COUNT = 85  # numbers: position, quaternion, covariance (36), linear, angular, covariance (36)


class OdometryColumns(NamedTuple):
    """N odometries, in the axes of the stream.

    Attributes:
        stamps_ns: (N,) stamps [ns].
        position: (N, 3) [m].
        quaternion_xyzw: (N, 4) attitude.
        pose_covariance: (N, 6, 6).
        linear: (N, 3) velocity in the child's axes [m/s].
        angular: (N, 3) angular rate in the child's axes [rad/s].
        twist_covariance: (N, 6, 6).
    """

    stamps_ns: Stamps
    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    linear: Array
    angular: Array
    twist_covariance: Array


def encode_odometries(frames: tuple[str, str], columns: OdometryColumns) -> Iterator[bytes]:
    """Many messages of a topic.

    Args:
        frames: frame_id and child_frame_id.
        columns: The numbers.
    """
    stamps_ns, *numbers = columns
    count, middle = len(stamps_ns), _frames(*frames)
    rows = np.empty(
        count,
        np.dtype(
            [
                ("encapsulation", "S4"),
                ("sec", "<i4"),
                ("nanosec", "<u4"),
                ("frames", "u1", (len(middle),)),
                ("numbers", "<f8", (_COUNT,)),
            ]
        ),
    )
    rows["encapsulation"] = ENCAPSULATION
    rows["sec"], rows["nanosec"] = np.divmod(stamps_ns, NS)
    rows["frames"] = np.frombuffer(middle, np.uint8)
    if count:
        rows["numbers"] = np.concatenate([n.reshape(count, -1) for n in numbers], axis=1)
    for row in rows:
        yield row.tobytes()


class OdometryEncoder:
    """Makes one message of a topic after the other.

    Args:
        frame_id: Of the pose.
        child_frame_id: Of the twist.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        head = ENCAPSULATION + bytes(_STAMP.size) + _frames(frame_id, child_frame_id)
        self._data = bytearray(head + bytes(8 * _COUNT))
        numbers = np.frombuffer(self._data, "<f8", _COUNT, len(head))
        self._position, self._quaternion = numbers[0:3], numbers[3:7]
        self._pose_covariance = numbers[7:43].reshape(6, 6)
        self._linear, self._angular = numbers[43:46], numbers[46:49]
        self._twist_covariance = numbers[49:85].reshape(6, 6)

    def encode(
        self,
        stamp_ns: int,
        position: Array,
        quaternion_xyzw: Array,
        pose_covariance: Array,
        linear: Array,
        angular: Array,
        twist_covariance: Array,
    ) -> bytes:
        """A message, see `OdometryColumns`."""
        _STAMP.pack_into(self._data, len(ENCAPSULATION), *divmod(stamp_ns, NS))
        self._position[:] = position
        self._quaternion[:] = quaternion_xyzw
        self._pose_covariance[:] = pose_covariance
        self._linear[:] = linear
        self._angular[:] = angular
        self._twist_covariance[:] = twist_covariance
        return bytes(self._data)


def _frames(frame_id: str, child_frame_id: str) -> bytes:
    """Both frames, up to where the numbers begin."""
    frame = encoded_text(frame_id)
    both = frame + bytes(-len(frame) % 4) + encoded_text(child_frame_id)
    return both + bytes(-(_STAMP.size + len(both)) % 8)
