"""The stamps of a topic: rate, gaps, disorder, and the latency against the time of recording."""

from array import array
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS

PAUSES = 3.0  # intervals: a longer one is a gap
#: A recorder finds the topics one after the other [s]: so much is missing at either end of any.
ENDS = 1.0
#: A difference between stamp and time of recording that no network causes [s]: other clocks.
OTHER_CLOCK = 60.0


@dataclass(frozen=True)
class StampFacts:
    """What the stamps of a topic show.

    Attributes:
        count: Number of messages.
        unset: Number of stamps that are zero; all else is of the others.
        first_ns: Earliest stamp; 0 where there is none.
        last_ns: Latest stamp.
        rate: One over the median interval [Hz]; None with fewer than two stamps.
        repeated: Number of stamps that occurred before.
        backward: Number of messages with a stamp before that of the message before them.
        gaps: Number of intervals that are longer than a gap.
        longest: Longest interval [s].
        missing: Sum of the gaps [s].
        pause: Interval from which on a time without messages is a gap [s].
        recorded_ns: Times of recording of the first and the last message; None without any.
        latency: Time of recording minus stamp [s]: 5 %, median, 95 %.
    """

    count: int
    unset: int
    first_ns: int
    last_ns: int
    rate: float | None
    repeated: int
    backward: int
    gaps: int
    longest: float
    missing: float
    pause: float
    recorded_ns: tuple[int, int] | None
    latency: tuple[float, float, float] | None

    @property
    def has_own_clock(self) -> bool:
        """Whether stamps and times of recording are of different clocks."""
        return self.latency is not None and abs(self.latency[1]) > OTHER_CLOCK

    def missing_at_ends(self, begin_ns: int, end_ns: int) -> tuple[float, float]:
        """How long before the first and after the last message nothing came [s]; 0 for no gap.

        Times of recording tell it: they are of one clock for all topics.

        Args:
            begin_ns: Time at which the recording of all sensors begins.
            end_ns: Time at which it ends.
        """
        if self.recorded_ns is None:
            return 0.0, 0.0
        least = max(self.pause, ENDS)
        before, after = (self.recorded_ns[0] - begin_ns) / NS, (end_ns - self.recorded_ns[1]) / NS
        return before if before > least else 0.0, after if after > least else 0.0


class StampLog:
    """Collects the stamps of a topic, 16 bytes for each message."""

    def __init__(self) -> None:
        self._stamps, self._times = array("q"), array("q")

    def add(self, stamp_ns: int, time_ns: int) -> None:
        """Take a message.

        Args:
            stamp_ns: Its stamp.
            time_ns: When it was recorded.
        """
        self._stamps.append(stamp_ns)
        self._times.append(time_ns)

    def facts(self, longest: float = 0.0) -> StampFacts:
        """What they show.

        Args:
            longest: Interval up to which there is no gap [s]; at least `PAUSES` usual ones.
        """
        stamps, recorded = np.array(self._stamps, np.int64), np.array(self._times, np.int64)
        times = recorded[stamps != 0]
        count, stamps = len(stamps), stamps[stamps != 0]
        steps = np.diff(np.unique(stamps)) / NS
        usual = float(np.median(steps)) if steps.size else None
        pause = max(longest, PAUSES * usual) if usual else longest
        gaps = steps[steps > pause] if usual else steps[:0]
        late = (times - stamps) / NS
        return StampFacts(
            count=count,
            unset=count - len(stamps),
            first_ns=int(stamps.min()) if stamps.size else 0,
            last_ns=int(stamps.max()) if stamps.size else 0,
            rate=1.0 / usual if usual else None,
            repeated=len(stamps) - len(np.unique(stamps)),
            backward=int((np.diff(stamps) < 0).sum()),
            gaps=len(gaps),
            longest=float(steps.max()) if steps.size else 0.0,
            missing=float(gaps.sum()),
            pause=pause,
            recorded_ns=(int(recorded.min()), int(recorded.max())) if count else None,
            latency=_three(late) if stamps.size else None,
        )


def _three(values: Array) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return float(low), float(middle), float(high)
