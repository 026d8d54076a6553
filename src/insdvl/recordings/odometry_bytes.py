"""Many nav_msgs/Odometry as bytes at once: the general encoder takes 360 us for each of them.

The layout of the message in CDR is fixed but for the two frames, which are the same in all messages
of a topic. So the messages are the rows of one array.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.messages.convert import ODOMETRY
from insdvl.navigation.events import NS
from insdvl.recordings.base import Raw

_ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little-endian; alignment counts from behind it


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


def encode_odometries(
    topic: str, frames: tuple[str, str], columns: OdometryColumns
) -> Iterator[Raw]:
    """The messages of a topic, recorded at their stamps.

    Args:
        topic: The topic.
        frames: frame_id and child_frame_id.
        columns: The numbers.
    """
    stamps_ns, *numbers = columns
    count = len(stamps_ns)
    frame, child = (_text(name) for name in frames)
    aligned = -len(frame) % 4  # the length of the child begins at a multiple of four bytes
    middle = frame + bytes(aligned) + child
    middle += bytes(-(8 + len(middle)) % 8)
    rows = np.empty(
        count,
        np.dtype(
            [
                ("encapsulation", "S4"),
                ("sec", "<i4"),
                ("nanosec", "<u4"),
                ("frames", "u1", (len(middle),)),
                ("numbers", "<f8", (sum(n[0].size for n in numbers) if count else 0,)),
            ]
        ),
    )
    rows["encapsulation"] = _ENCAPSULATION
    rows["sec"], rows["nanosec"] = np.divmod(stamps_ns, NS)
    rows["frames"] = np.frombuffer(middle, np.uint8)
    if count:
        rows["numbers"] = np.concatenate([n.reshape(count, -1) for n in numbers], axis=1)
    for time_ns, row in zip(stamps_ns.tolist(), rows, strict=True):
        yield Raw(topic, ODOMETRY, time_ns, row.tobytes())


def _text(name: str) -> bytes:
    """A string in CDR: its length with the zero at its end, and both."""
    encoded = name.encode() + b"\0"
    return len(encoded).to_bytes(4, "little") + encoded
