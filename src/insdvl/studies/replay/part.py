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
        clock_ns: Stamp of a sample less the time at which it was recorded.
        refused_ns: When the messages were recorded that are not used, by topic and reason.
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
    clock_ns: int | None = None
    refused_ns: dict[Refused, "array[int]"] = field(default_factory=dict)

    def refuse(self, key: Refused, time_ns: int) -> None:
        """Keep the time of recording of a message that is not used."""
        self.refused_ns.setdefault(key, array("q")).append(time_ns)

    def refused_stamps(self, key: Refused) -> Stamps:
        """When they came (N,), on the clock of the samples: their own stamps may be nonsense."""
        return np.array(self.refused_ns[key], np.int64) + (self.clock_ns or 0)

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
            self.travelled.add(times_ns, _speeds(self.filter, known["nav"]))
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
