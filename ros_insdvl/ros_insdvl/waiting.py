"""Messages that wait until the extrinsics are known, since the filter is made from those."""

from collections import deque
from typing import Any

from insdvl.messages.extrinsics import Extrinsics

#: Most messages that are kept: 100 s of an IMU at 100 Hz.
MAX_KEPT = 10_000


class Waiting:
    """What a filter that has no extrinsics yet has received.

    Args:
        extrinsics: That are awaited.

    Attributes:
        extrinsics: The same.
        kept: Topic and message, in the order of arrival.
    """

    def __init__(self, extrinsics: Extrinsics) -> None:
        self.extrinsics = extrinsics
        self.kept: deque[tuple[str, Any]] = deque()

    def keep(self, topic: str, message: Any) -> str | None:
        """Keep a message; the topic of the oldest one, where that is given up for it."""
        self.extrinsics.hear(topic, message)
        self.kept.append((topic, message))
        return self.kept.popleft()[0] if len(self.kept) > MAX_KEPT else None
