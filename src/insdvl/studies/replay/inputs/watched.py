"""A recording whose progress is shown, and that ends where someone interrupts."""

import signal
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from types import FrameType

from insdvl.jobs.progress import Progress
from insdvl.navigation.events import NS
from insdvl.recordings.base import Raw
from insdvl.recordings.played import Recording


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed within this context; the second time it interrupts as ever."""
    seen: list[int] = []

    def take(number: int, _: FrameType | None) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    before = signal.signal(signal.SIGINT, take)
    try:
        yield lambda: bool(seen)
    finally:
        signal.signal(signal.SIGINT, before)


class Watched(Recording):
    """A recording that is iterated over as a whole.

    Args:
        recording: The recording.
        progress: Is shown the seconds of the recording that are done; None for nothing.
        ends: Whether it ends here.
    """

    def __init__(
        self, recording: Recording, progress: Progress | None, ends: Callable[[], bool]
    ) -> None:
        self._recording, self._progress, self._ends = recording, progress, ends

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return self._recording.topics

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        return self._recording.on(topics)

    def __iter__(self) -> Iterator[Raw]:
        first_ns = shown = None
        for raw in self._recording:
            if self._ends():
                return
            first_ns = raw.time_ns if first_ns is None else first_ns
            second = (raw.time_ns - first_ns) // NS
            if self._progress is not None and second != shown:
                self._progress.show(second)
                shown = second
            yield raw
