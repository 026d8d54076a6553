"""What is kept of one time of a recording, between two time jumps."""

from array import array
from dataclasses import dataclass, field

import numpy as np

from insdvl.arrays import Array, Records, Stamps
from insdvl.messages.refusals import Refused
from insdvl.navigation.events import NS
from insdvl.navigation.filter import LAYOUT, Filter
from insdvl.navigation.state.fields import State
from insdvl.navigation.state.layout import counters
from insdvl.studies.replay.consumer import initialised
from insdvl.timeline.output import AppliedUpdate, Final


class Travelled:
    """The length of a path, by the speed along it.

    Positions would not tell it: while the heading is being found, a correction of it turns the
    whole path about its start, and the vehicle has not moved.
    """

    def __init__(self) -> None:
        self.length = 0.0  # [m]
        self._before: tuple[int, float] | None = None

    def begin(self) -> None:
        """What follows is not joined to what was added: nothing was known in between."""
        self._before = None

    def add(self, times_ns: Stamps, speeds: Array) -> None:
        """The next stamps (N,) and speeds (N,) [m/s]."""
        if self._before is not None:
            times_ns = np.concatenate([[self._before[0]], times_ns])
            speeds = np.concatenate([[self._before[1]], speeds])
        steps = np.diff(times_ns) / NS
        self.length += float(steps @ (speeds[1:] + speeds[:-1])) / 2.0
        self._before = int(times_ns[-1]), float(speeds[-1])


class Pace:
    """The speed once in a second.

    Attributes:
        times_ns: Stamps.
        speeds: Of base_link [m/s].
    """

    def __init__(self) -> None:
        self.times_ns, self.speeds = array("q"), array("d")

    def add(self, times_ns: Stamps, speeds: Array) -> None:
        """The next stamps (N,) and speeds (N,) [m/s]."""
        before = self.times_ns[-1] // NS if self.times_ns else -1
        at = np.flatnonzero(np.diff(times_ns // NS, prepend=before))
        self.times_ns.extend(times_ns[at].tolist())
        self.speeds.extend(speeds[at].tolist())


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
        travelled: By base_link.
        pace: The speed while the state was known.
        clock_ns: Stamp of the newest sample less the time at which it was recorded; None before.
        refused_ns: When the messages came that are not used, by topic and reason, on the clock of
            the samples: their own stamps may be nonsense, and the recorder has another clock.
        silent: Time between the first message and the first sample, and between the last sample
            and the last message, by the clock of the recorder [s].
    """

    filter: Filter
    size: int = 0
    first_ns: int = 0
    known_ns: tuple[int, int] | None = None
    end: Records = field(default_factory=lambda: LAYOUT.empty()[:0])
    known: Records = field(default_factory=lambda: LAYOUT.empty()[:0])
    updates: list[AppliedUpdate] = field(default_factory=list)
    steps: dict[str, tuple[list[int], list[int]]] = field(default_factory=dict)
    travelled: Travelled = field(default_factory=Travelled)
    pace: Pace = field(default_factory=Pace)
    clock_ns: int | None = None
    refused_ns: dict[Refused, "array[int]"] = field(default_factory=dict)

    silent: tuple[float, float] = (0.0, 0.0)
    _recorded_ns: tuple[int, int] | None = None  # first message, last sample

    def refuse(self, key: Refused, time_ns: int) -> int:
        """Keep when a message was recorded that is not used; returns it on the samples' clock."""
        stamp_ns = time_ns + (self.clock_ns or 0)
        self.refused_ns.setdefault(key, array("q")).append(stamp_ns)
        return stamp_ns

    def heard(self, time_ns: int) -> None:
        """A message was recorded at this time."""
        if self._recorded_ns is None:
            self._recorded_ns = time_ns, time_ns
        if self.clock_ns is not None:
            self.silent = self.silent[0], (time_ns - self._recorded_ns[1]) / NS

    def sampled(self, stamp_ns: int, first_ns: int, last_ns: int) -> None:
        """Samples were taken.

        Args:
            stamp_ns: Of the newest of them.
            first_ns: When the first one was recorded.
            last_ns: When the last one was recorded.
        """
        self.heard(first_ns)
        assert self._recorded_ns is not None
        clock_ns = stamp_ns - last_ns
        if self.clock_ns is None:
            self.silent = (first_ns - self._recorded_ns[0]) / NS, 0.0
            for key, times in self.refused_ns.items():  # they came before the clock was known
                self.refused_ns[key] = array("q", (time_ns + clock_ns for time_ns in times))
        self.clock_ns, self._recorded_ns = clock_ns, (self._recorded_ns[0], last_ns)
        self.silent = self.silent[0], 0.0

    @property
    def last_ns(self) -> int:
        """Stamp of the last state; 0 where there is none."""
        return int(self.end[0]["nav"]["time_ns"]) if len(self.end) else 0

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
        follows = bool(states[0]["nav"]["initialised"])
        for known in initialised(states):
            times_ns = known["nav"]["time_ns"]
            first_ns = self.known_ns[0] if self.known_ns else int(times_ns[0])
            self.known_ns, self.known = (first_ns, int(times_ns[-1])), known[-1:].copy()
            if not follows:
                self.travelled.begin()
            speeds = _speeds(self.filter, known["nav"])
            self.travelled.add(times_ns, speeds)
            self.pace.add(times_ns, speeds)
            follows = False
        if not nav["initialised"][-1]:
            self.travelled.begin()

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


def _speeds(filter_: Filter, nav: State) -> Array:
    """Speeds of base_link (N,) [m/s]."""
    v_b = np.einsum("kji,kj->ki", nav["C_n_b"], nav["v_n"])
    v_b -= np.cross(nav["w_nb_b"], filter_.vehicle.l_b_imu)
    return np.asarray(np.linalg.norm(v_b, axis=1))
