"""Many nav_msgs/Odometry as bytes and from bytes at once: the general encoder takes 360 us each.

The layout of the message in CDR is fixed but for the two frames, which are the same in all messages
of a topic. So the messages are the rows of one array.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    rows = np.zeros(len(stamps_ns), _layout(frames))
    rows["encapsulation"] = _ENCAPSULATION
    rows["sec"], rows["nanosec"] = np.divmod(stamps_ns, NS)
    for name, place in zip(("frame", "child"), _places(frames), strict=True):
        rows[name] = np.frombuffer(place.text, np.uint8)
    if len(rows):
        rows["numbers"] = np.concatenate([n.reshape(len(rows), -1) for n in numbers], axis=1)
    data, size = rows.tobytes(), rows.itemsize
    for k, time_ns in enumerate(stamps_ns.tolist()):
        yield Raw(topic, ODOMETRY, time_ns, data[k * size : (k + 1) * size])


def decode_odometries(
    messages: Sequence[bytes], frames: tuple[str, str]
) -> tuple[OdometryColumns, NDArray[np.bool_]]:
    """The numbers of messages, and which of them (N,) have the layout that they should have.

    The others are not little-endian, have other frames or another length, or their stamp is not
    one: `base.decode` and `convert.initial` tell what they are.

    Args:
        messages: (N,) in CDR.
        frames: frame_id and child_frame_id.
    """
    layout, places = _layout(frames), _places(frames)
    fit = np.array(
        [
            len(data) == layout.itemsize
            and data[:2] == _ENCAPSULATION[:2]
            and all(data.startswith(place.text, place.begin) for place in places)
            for data in messages
        ],
        dtype=bool,
    )
    rows = np.zeros(len(messages), layout)
    joined = b"".join([data for data, is_fit in zip(messages, fit, strict=True) if is_fit])
    if joined:
        rows[fit] = np.frombuffer(joined, layout)
    sec, nanosec, numbers = rows["sec"].astype(np.int64), rows["nanosec"], rows["numbers"]
    fit &= (sec >= 0) & (nanosec < NS)
    begin, parts = 0, []
    for shape in _SHAPES:
        end = begin + math.prod(shape)
        parts.append(numbers[:, begin:end].reshape(-1, *shape))
        begin = end
    return OdometryColumns(sec * NS + nanosec, *parts), fit


#: Shapes of the numbers, in the order of `OdometryColumns`.
_SHAPES = (3,), (4,), (6, 6), (3,), (3,), (6, 6)


class _Place(NamedTuple):
    """Where a string is in a message, and its bytes."""

    begin: int
    text: bytes

    @property
    def end(self) -> int:
        return self.begin + len(self.text)


def _places(frames: tuple[str, str]) -> tuple[_Place, _Place]:
    """The two frames; the length of the child begins at a multiple of four bytes."""
    frame = _Place(12, _text(frames[0]))
    return frame, _Place(frame.end + -frame.end % 4, _text(frames[1]))


def _layout(frames: tuple[str, str]) -> np.dtype[np.void]:
    """A message; the numbers begin at a multiple of eight bytes behind the encapsulation."""
    frame, child = _places(frames)
    numbers, count = child.end + (4 - child.end) % 8, sum(map(math.prod, _SHAPES))
    fields = {
        "encapsulation": ("S4", 0),
        "sec": ("<i4", 4),
        "nanosec": ("<u4", 8),
        "frame": (("u1", (len(frame.text),)), frame.begin),
        "child": (("u1", (len(child.text),)), child.begin),
        "numbers": (("<f8", (count,)), numbers),
    }
    return np.dtype(
        {
            "names": list(fields),
            "formats": [form for form, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": numbers + 8 * count,
        }
    )


def _text(name: str) -> bytes:
    """A string in CDR: its length with the zero at its end, and both."""
    encoded = name.encode() + b"\0"
    return len(encoded).to_bytes(4, "little") + encoded
