"""What is kept of one time of a recording, between two time jumps."""

from dataclasses import dataclass, field

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.geometry import odom
from insdvl.navigation.state.fields import State
from insdvl.navigation.state.layout import counters
from insdvl.studies.evaluation.metrics import path_length
from insdvl.studies.replay.consumer import initialised
from insdvl.timeline.output import AppliedUpdate, Final

#: Fewest points of a long path; it has at most twice as many.
POINTS = 5000


class Path:
    """Points of a path, at equal steps that grow with its length."""

    def __init__(self) -> None:
        self._points = np.empty((0, 3))
        self._seen, self._step = 0, 1

    def chosen(self, count: int) -> slice:
        """Which of the next positions are wanted."""
        return slice(-self._seen % self._step, count, self._step)

    def add(self, count: int, points: Array) -> None:
        """The chosen ones (M, 3) of the next positions [m]."""
        self._seen += count
        self._points = np.concatenate([self._points, points])
        while len(self._points) >= 2 * POINTS:
            self._points, self._step = self._points[::2], 2 * self._step

    @property
    def length(self) -> float:
        """Length [m]."""
        return path_length(self._points)


@dataclass
class Part:
    """What is kept of one time.

    Attributes:
        filter: The filter.
        size: Number of samples.
        first_ns: Stamp of the first state.
        known_ns: Stamps of the first and the last initialised state; None without any.
        end: (1,) the last state, or none.
        known: (1,) the last initialised state, or none.
        updates: The measurements, in the order of stamps.
        steps: Stamps at which a counter was raised and by how much, by the name of the counter.
        path: Of base_link.
    """

    filter: Filter
    size: int = 0
    first_ns: int = 0
    known_ns: tuple[int, int] | None = None
    end: Records = field(default_factory=lambda: LAYOUT.empty()[:0])
    known: Records = field(default_factory=lambda: LAYOUT.empty()[:0])
    updates: list[AppliedUpdate] = field(default_factory=list)
    steps: dict[str, tuple[list[int], list[int]]] = field(default_factory=dict)
    path: Path = field(default_factory=Path)

    def take(self, final: Final) -> None:
        """What follows."""
        self.updates += final.updates
        states = final.states
        if not len(states):
            return
        self._count(states)
        nav = states["nav"]
        if not self.size:
            self.first_ns = int(nav["time_ns"][0])
        self.size += len(states)
        self.end = states[-1:].copy()
        for known in initialised(states):
            times_ns = known["nav"]["time_ns"]
            first_ns = self.known_ns[0] if self.known_ns else int(times_ns[0])
            self.known_ns, self.known = (first_ns, int(times_ns[-1])), known[-1:].copy()
            chosen = known["nav"][self.path.chosen(len(known))]
            self.path.add(len(known), _position(self.filter, chosen))

    def _count(self, states: Records) -> None:
        """Find the steps of the counters."""
        before = counters(self.end[0]) if len(self.end) else {}
        for name, (group, counter) in counters(states).items():
            values = group[counter]
            last = int(before[name][0][counter]) if before else 0
            if values[-1] == last and values[0] == last:
                continue  # it never falls
            rises = np.diff(values, prepend=last)
            at = np.flatnonzero(rises > 0)
            stamps_ns, counts = self.steps.setdefault(name, ([], []))
            stamps_ns += states["channels"]["imu_ns"][at].tolist()
            counts += rises[at].tolist()


def _position(filter_: Filter, nav: State) -> Array:
    """Position of base_link in map (N, 3) [m], as north, east, down."""
    if not len(nav):
        return np.empty((0, 3))
    origin = np.array([nav[name][-1] for name in ("lat_0", "lon_0", "h_0")])
    p_o, gamma = odom.in_odom(nav["llh"], origin)
    return np.asarray(p_o - odom.turned(nav["C_n_b"], gamma) @ filter_.vehicle.l_b_imu)
