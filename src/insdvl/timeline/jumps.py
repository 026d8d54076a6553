"""Time jumps: a clock that was set, a recording that begins again.

What is of another time is refused but kept a while as a suspect. When samples of that time come one
after the other, and none of the present time in between, they are a run that may be followed (see
docs/explanation/filter.md, Time).
"""

from collections import deque
from dataclasses import dataclass

from insdvl.navigation.events import NS, Event, Imu

#: So many samples of another time in a row are a time jump.
JUMP_SAMPLES = 10
#: So many samples behind a gap longer than max_delay are believed; one alone may be a wrong stamp.
GAP_SAMPLES = 2
#: Samples of one run are no farther apart than this, or imu.max_gap where that is longer.
RUN_GAP_NS = NS
#: Most events that are kept as suspects.
MAX_SUSPECTS = 1000


@dataclass(frozen=True, slots=True)
class TimeJump:
    """The samples went over to another time.

    Attributes:
        from_ns: Newest stamp of the old time.
        to_ns: First stamp of the new time.
    """

    from_ns: int
    to_ns: int


@dataclass(slots=True)
class Run:
    """Samples of another time that came one after the other.

    Attributes:
        first_ns: Stamp of the first one.
        last_ns: Newest stamp.
        count: Number of samples, without those that step back.
        is_gap: Whether it lies ahead of the present time by no more than the jump limit.
    """

    first_ns: int
    last_ns: int
    count: int = 1
    is_gap: bool = False


class Suspects:
    """Events of another time.

    Args:
        near_ns: Samples as near to the newest one are of its time.
        run_gap_ns: Farthest that two samples of one run are apart.
        jump_limit_ns: How far ahead a gap may reach.
    """

    def __init__(self, near_ns: int, run_gap_ns: int, jump_limit_ns: int) -> None:
        self._near_ns = near_ns
        self._run_gap_ns = max(RUN_GAP_NS, run_gap_ns)
        self._jump_limit_ns = jump_limit_ns
        self._run: Run | None = None  # that the last suspects made
        # Each with the newest stamp of the present time when it came.
        self._kept: deque[tuple[int, Event]] = deque(maxlen=MAX_SUSPECTS)

    @property
    def events(self) -> list[Event]:
        """All that are kept, in the order of their arrival."""
        return [event for _, event in self._kept]

    def keep(self, event: Event, newest_ns: int) -> Run | None:
        """Keep an event; returns the run that it completes, None where there is none.

        Args:
            event: Of another time.
            newest_ns: Newest stamp of the present time.
        """
        stamp_ns = event.stamp_ns
        self._kept.append((newest_ns, event))
        if not isinstance(event, Imu) or abs(stamp_ns - newest_ns) <= self._near_ns:
            return None
        run = self._run
        if run is None or abs(stamp_ns - run.last_ns) > self._run_gap_ns:
            self._run = run = Run(stamp_ns, stamp_ns)
        elif stamp_ns > run.last_ns:
            run.last_ns, run.count = stamp_ns, run.count + 1
        run.is_gap = 0 < stamp_ns - newest_ns <= self._jump_limit_ns
        return run if run.count >= (GAP_SAMPLES if run.is_gap else JUMP_SAMPLES) else None

    def present(self, oldest_ns: int) -> None:
        """A sample of the present time came: no run of suspects is one.

        Args:
            oldest_ns: Suspects stay while stamps that arrive in another order could still make them
                needed; this is the newest stamp that makes none.
        """
        self._run = None
        while self._kept and self._kept[0][0] < oldest_ns:
            self._kept.popleft()

    def forget(self) -> None:
        """Forget all that are kept."""
        self._kept.clear()

    def end_run(self) -> None:
        """The next suspect begins a run of its own."""
        self._run = None
