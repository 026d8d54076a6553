"""A part of a recording."""

from collections.abc import Collection, Iterator

from insdvl.navigation.events import NS
from insdvl.recordings.base import BagError, Raw
from insdvl.recordings.played import Recording


class Between(Recording):
    """The messages that were recorded between two times.

    Args:
        recording: The recording.
        begin: Time after its first message [s].
        end: The same of the end; None for all that follows.

    Raises:
        BagError: Nothing was recorded there.
    """

    def __init__(self, recording: Recording, begin: float, end: float | None) -> None:
        self._recording = recording
        first = next(iter(recording)).time_ns
        self._begin_ns = first + round(begin * NS)
        self._end_ns = None if end is None else first + round(end * NS)
        self._topics = frozenset(raw.topic for raw in self.on(recording.topics))
        if not self._topics:
            until = "its end" if end is None else f"{end:g} s"
            raise BagError(f"nothing is recorded from {begin:g} s to {until}")

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return self._topics

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        for raw in self._recording.on(topics):
            if self._end_ns is not None and raw.time_ns > self._end_ns:
                return  # messages come in the order of their recording
            if raw.time_ns >= self._begin_ns:
                yield raw
