"""The odometry of a topic, kept as it arrived and turned into numbers when they are asked for."""

import struct
from collections import deque
from itertools import islice

import numpy as np

from insdvl.arrays import Array, Stamps
from insdvl.messages.convert import RejectedMessage
from insdvl.navigation.events import NS

#: nav_msgs/Odometry in CDR: the stamp behind the encapsulation, and at the end, behind two texts,
#: position (3), quaternion (4), covariance (36), linear and angular velocity (6), covariance (36).
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_NUMBERS = 85
_LITTLE_ENDIAN = 1


class OdometrySeries:
    """What is kept of an odometry topic: a stamp and a row of numbers for each message.

    The columns are those of the slices below; variances are the diagonal of the covariance.
    """

    POSITION = slice(0, 3)
    QUATERNION = slice(3, 7)
    VELOCITY = slice(7, 10)
    POSE_VARIANCE = slice(10, 16)
    VELOCITY_VARIANCE = slice(16, 19)

    _COLUMNS = np.r_[0:7, 43:46, 7:43:7, 49:64:7]  # of the numbers in a message

    def __init__(self, keep: int) -> None:
        self._stamps: deque[int] = deque(maxlen=keep)
        self._numbers: deque[bytes] = deque(maxlen=keep)

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, data: bytes) -> None:
        """Keep a message, given as its bytes.

        Raises:
            RejectedMessage: They are not those of an odometry message.
        """
        shortest = _STAMP_AT + _STAMP.size + 8 * _NUMBERS
        if len(data) < shortest or not data[1] & _LITTLE_ENDIAN:
            raise RejectedMessage("unreadable", f"{len(data)} bytes are not an odometry message")
        sec, nanosec = _STAMP.unpack_from(data, _STAMP_AT)
        self._stamps.append(sec * NS + nanosec)
        self._numbers.append(data[-8 * _NUMBERS :])

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the last message."""
        return self._stamps[-1] if self._stamps else None

    def count_since(self, stamp_ns: int) -> int:
        """How many messages have come since the last one that is older than a stamp."""
        older = (k for k, s in enumerate(reversed(self._stamps)) if s < stamp_ns)
        return next(older, len(self))

    def arrays(self, count: int | None = None) -> tuple[Stamps, Array]:
        """Stamps (N,) and rows (N, 19) of the last ``count`` messages, or of all, by stamp."""
        n = len(self) if count is None else min(count, len(self))
        stamps = np.fromiter(islice(reversed(self._stamps), n), dtype=np.int64, count=n)
        numbers = np.frombuffer(b"".join(islice(reversed(self._numbers), n)), "<f8")
        rows = numbers.reshape(n, _NUMBERS)[:, self._COLUMNS]
        order = np.argsort(stamps, kind="stable")
        return stamps[order], rows[order]
