"""How many IMU samples are missing, by the stamps of those that arrived."""

from heapq import heappop, heappush

from insdvl.navigation.events import NS
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import NEVER

#: Share of a sample's distance by which the grid of the nominal rate follows the stamps.
FOLLOW = 0.2


class ExpectedSamples:
    """Counts the IMU samples that arrived and those that were expected by their stamps.

    The stamps lie near the points of a grid with the nominal interval, and the grid follows them:
    jitter moves a sample beside its point, a clock of a slightly different speed moves the grid,
    and only a missing sample leaves a point empty. A sample is counted when none before it can
    still arrive late. Samples missing in a gap are not expected: gaps are reported as such.

    Args:
        parameters: Parameters of the filter.
    """

    def __init__(self, parameters: FilterParameters) -> None:
        self._interval_ns = NS / parameters.imu.rate
        self._max_gap_ns = round(parameters.imu.max_gap * NS)
        self._max_delay_ns = round(parameters.max_delay * NS)
        self.expected = 0
        self.arrived = 0
        self.restart()

    def restart(self) -> None:
        """Continue the counts after a time jump, with stamps of another time."""
        self._waiting: list[int] = []  # a heap
        self._newest_ns = NEVER
        self._last_ns: int | None = None
        self._grid_ns = 0  # the point of the last sample

    def add(self, stamp_ns: int) -> None:
        """Take the stamp of a sample that is at most `max_delay` late."""
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            return  # of a time that the clock went back to; `restart` follows
        heappush(self._waiting, stamp_ns)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        while self._waiting[0] < self._newest_ns - self._max_delay_ns:
            self._count(heappop(self._waiting))

    def _count(self, stamp_ns: int) -> None:
        """Count the next stamp, in increasing order."""
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
