"""sensor_msgs/Imu from its bytes, of one message or of many at once.

The layout in CDR is fixed but for the length of the frame_id: encapsulation (4 bytes), seconds and
nanoseconds of the stamp, length and bytes of the frame_id with the zero at its end, and from the
next multiple of eight bytes behind the encapsulation on 37 doubles. A general decoder takes 40
times as long for it.

Every message is checked. One that does not fit, such as a big-endian one, is no fault: the general
decoder knows what to do with it.
"""

from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array
from insdvl.messages.cdr.layout import ENCAPSULATION, decoded_text

#: Columns of the numbers, in their order in the message.
ORIENTATION = slice(0, 4)
ORIENTATION_COVARIANCE = slice(4, 13)
ANGULAR_VELOCITY = slice(13, 16)
ANGULAR_VELOCITY_COVARIANCE = slice(16, 25)
LINEAR_ACCELERATION = slice(25, 28)
LINEAR_ACCELERATION_COVARIANCE = slice(28, 37)
COLUMNS = 37

_HEAD = Struct("<4siII")  # encapsulation, seconds, nanoseconds, length of the frame_id
_NUMBERS = Struct(f"<{COLUMNS}d")


class Stamp(NamedTuple):
    """A builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Header(NamedTuple):
    """A std_msgs/Header."""

    stamp: Stamp
    frame_id: str


class Vector(NamedTuple):
    """A geometry_msgs/Vector3."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """A geometry_msgs/Quaternion."""

    x: float
    y: float
    z: float
    w: float


class ImuMessage(NamedTuple):
    """A message that has the fields of a sensor_msgs/Imu.

    Attributes:
        header: Stamp and frame.
        numbers: (37,) all that follows, in the order of the slices above.
    """

    header: Header
    numbers: tuple[float, ...]

    @property
    def orientation(self) -> Quaternion:
        """Attitude."""
        return Quaternion(*self.numbers[ORIENTATION])

    @property
    def orientation_covariance(self) -> tuple[float, ...]:
        """(9,) row-major [rad^2]."""
        return self.numbers[ORIENTATION_COVARIANCE]

    @property
    def angular_velocity(self) -> Vector:
        """Angular rate [rad/s]."""
        return Vector(*self.numbers[ANGULAR_VELOCITY])

    @property
    def angular_velocity_covariance(self) -> tuple[float, ...]:
        """(9,) row-major [(rad/s)^2]."""
        return self.numbers[ANGULAR_VELOCITY_COVARIANCE]

    @property
    def linear_acceleration(self) -> Vector:
        """Specific force [m/s^2]."""
        return Vector(*self.numbers[LINEAR_ACCELERATION])

    @property
    def linear_acceleration_covariance(self) -> tuple[float, ...]:
        """(9,) row-major [(m/s^2)^2]."""
        return self.numbers[LINEAR_ACCELERATION_COVARIANCE]


class ImuColumns(NamedTuple):
    """N messages.

    Attributes:
        fits: (N,) whether the message has the layout; all else is zero where it has not.
        seconds: (N,) of the stamps.
        nanoseconds: (N,) of the stamps.
        numbers: (N, 37) in the order of the slices above.
        frame_ids: Those that occur, with their numbers.
        frames: (N,) number of each message's frame_id.
    """

    fits: NDArray[np.bool_]
    seconds: NDArray[np.int32]
    nanoseconds: NDArray[np.uint32]
    numbers: Array
    frame_ids: dict[str, int]
    frames: NDArray[np.intp]


def decode_imu(data: bytes) -> ImuMessage | None:
    """The message, None where it does not fit the layout.

    Args:
        data: Its bytes in CDR, the four of the encapsulation included.
    """
    if len(data) < _HEAD.size:
        return None
    encapsulation, seconds, nanoseconds, length = _HEAD.unpack_from(data)
    start = _numbers_start(length)
    if encapsulation != ENCAPSULATION or len(data) != start + _NUMBERS.size:
        return None
    frame_id = decoded_text(data[_HEAD.size : _HEAD.size + length])
    if frame_id is None:
        return None
    header = Header(Stamp(seconds, nanoseconds), frame_id)
    return ImuMessage(header, _NUMBERS.unpack_from(data, start))


def decode_imus(messages: Sequence[bytes]) -> ImuColumns:
    """All messages at once, each as `decode_imu` has it.

    Args:
        messages: (N,) their bytes in CDR.
    """
    n = len(messages)
    columns = ImuColumns(
        np.zeros(n, np.bool_),
        np.zeros(n, np.int32),
        np.zeros(n, np.uint32),
        np.zeros((n, COLUMNS)),
        {},
        np.zeros(n, np.intp),
    )
    sizes = np.fromiter(map(len, messages), np.intp, n)
    for size in np.unique(sizes).tolist():
        start = size - _NUMBERS.size  # of one that fits
        if start > _HEAD.size:
            _decode_same_size(messages, np.flatnonzero(sizes == size), start, columns)
    return columns


def _decode_same_size(
    messages: Sequence[bytes], at: NDArray[np.intp], start: int, columns: ImuColumns
) -> None:
    """Decode the messages at these indices into the columns; all have one size.

    Args:
        messages: All messages.
        at: (M,) indices.
        start: Of their numbers.
        columns: Of all messages.
    """
    parts = [("encapsulation", "S4"), ("seconds", "<i4"), ("nanoseconds", "<u4")]
    layout = np.dtype([*parts, ("frame", f"V{start - 12}"), ("numbers", "<f8", (COLUMNS,))])
    rows = np.frombuffer(b"".join([messages[i] for i in at]), layout)
    frames, which = _distinct(rows["frame"])
    known = np.array([_frame_number(frame, start, columns.frame_ids) for frame in frames])
    # numpy drops the zeros at the end of a string.
    fits = (rows["encapsulation"] == ENCAPSULATION.rstrip(b"\0")) & (known[which] >= 0)
    columns.fits[at] = fits
    good = at[fits]
    columns.seconds[good] = rows["seconds"][fits]
    columns.nanoseconds[good] = rows["nanoseconds"][fits]
    columns.numbers[good] = rows["numbers"][fits]
    columns.frames[good] = known[which[fits]]


def _frame_number(frame: bytes, start: int, frame_ids: dict[str, int]) -> int:
    """Number of a frame_id, which is given one where it is new; -1 where it does not fit.

    Args:
        frame: The bytes from its length on.
        start: Of the numbers behind it.
        frame_ids: Those that are known, with their numbers.
    """
    length = int.from_bytes(frame[:4], "little")
    frame_id = decoded_text(frame[4 : 4 + length]) if _numbers_start(length) == start else None
    return -1 if frame_id is None else frame_ids.setdefault(frame_id, len(frame_ids))


def _distinct(parts: NDArray[np.void]) -> tuple[list[bytes], NDArray[np.intp]]:
    """The different ones among parts (M,) of messages, and which of them each is (M,)."""
    numbered: dict[bytes, int] = {}
    which = [numbered.setdefault(part, len(numbered)) for part in parts.tolist()]
    return list(numbered), np.array(which, np.intp)


def _numbers_start(length: int) -> int:
    """Where the numbers begin behind a frame_id of so many bytes."""
    end = _HEAD.size + length - len(ENCAPSULATION)
    return len(ENCAPSULATION) + end + -end % 8
