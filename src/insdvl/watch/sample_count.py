"""How many IMU samples there should have been, by the stamps of those that came."""

from heapq import heappop, heappush

from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state import NEVER

#: Share of a sample's distance by which the grid of the nominal rate follows the stamps.
FOLLOW = 0.2


class ExpectedSamples:
    """Counts the IMU samples, and how many there should have been by their stamps.

    The stamps lie near the points of a grid of the nominal interval, and the grid follows them:
    jitter moves a sample beside its point, a clock of a slightly other speed moves the grid, and
    only a sample that is missing leaves a point without one. A sample counts when none before it
    can come late any more. What is missing in a gap is not expected: a gap is told as such.

    Args:
        parameters: Of the filter.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self._interval_ns = NS / parameters.imu.rate
        self._max_gap_ns = round(parameters.imu.max_gap * NS)
        self._max_delay_ns = round(parameters.max_delay * NS)
        self.expected = 0
        self.arrived = 0
        self.restart()

    def restart(self) -> None:
        """A new time: the counts go on, with its stamps."""
        self._waiting: list[int] = []  # a heap
        self._newest_ns = NEVER
        self._last_ns: int | None = None
        self._grid_ns = 0  # the point of the last sample

    def add(self, stamp_ns: int) -> None:
        """Take the stamp of a sample that is at most `max_delay` late."""
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            return  # of a time that is gone back to; `restart` follows
        heappush(self._waiting, stamp_ns)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        while self._waiting[0] < self._newest_ns - self._max_delay_ns:
            self._count(heappop(self._waiting))

    def _count(self, stamp_ns: int) -> None:
        """Take the next stamp, in their order."""
        if self._last_ns is None or stamp_ns - self._last_ns > self._max_gap_ns:
            self._grid_ns = stamp_ns
        else:
            distance_ns = stamp_ns - self._grid_ns
            points = round(distance_ns / self._interval_ns)
            step_ns = points * self._interval_ns
            self._grid_ns += round(step_ns + FOLLOW * (distance_ns - step_ns))
            self.expected += points
            self.arrived += 1
        self._last_ns = stamp_ns
