"""The odometry of a topic, kept as numbers."""

from collections import deque
from itertools import islice

import numpy as np
from nav_msgs.msg import Odometry

from insdvl.arrays import Array, Stamps
from insdvl.messages.cdr.odometry_bytes import OdometryMessage
from insdvl.messages.convert import stamp_ns


class OdometrySeries:
    """What is kept of an odometry topic: a stamp and a row of numbers for each message.

    The columns are those of the slices below; variances are the diagonal of the covariance.
    """

    POSITION = slice(0, 3)
    QUATERNION = slice(3, 7)
    VELOCITY = slice(7, 10)
    POSE_VARIANCE = slice(10, 16)
    VELOCITY_VARIANCE = slice(16, 19)

    def __init__(self, keep: int) -> None:
        self._stamps: deque[int] = deque(maxlen=keep)
        self._rows: deque[list[float]] = deque(maxlen=keep)

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, message: Odometry | OdometryMessage) -> None:
        """Keep a message."""
        pose, twist = message.pose, message.twist
        p, q, v = pose.pose.position, pose.pose.orientation, twist.twist.linear
        self._stamps.append(stamp_ns(message.header))
        self._rows.append(
            [
                *(p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z),
                *map(float, pose.covariance[::7]),
                *map(float, twist.covariance[:15:7]),
            ]
        )

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the last message."""
        return self._stamps[-1] if self._stamps else None

    def arrays(self, count: int | None = None) -> tuple[Stamps, Array]:
        """Stamps (N,) and rows (N, 19) of the last ``count`` messages, or of all, by stamp."""
        n = len(self) if count is None else min(count, len(self))
        stamps = np.fromiter(islice(reversed(self._stamps), n), dtype=np.int64, count=n)
        rows = np.array(list(islice(reversed(self._rows), n)), dtype=float).reshape(n, 19)
        order = np.argsort(stamps, kind="stable")
        return stamps[order], rows[order]
