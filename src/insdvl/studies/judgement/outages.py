"""When a sensor was lost in a replay: a DVL that was not used, an IMU that starts late or stops."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from insdvl.navigation.events import NS
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.studies.judgement.finding import Finding
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.part import Part
from insdvl.watch.outages import LOST, OUTAGE

#: Usual intervals of the pings: a DVL that pings every 5 s is not lost between two of them.
PAUSES = 3.0
#: A vehicle that is slower is at rest, and needs no DVL [m/s].
AT_REST = 0.1
#: Share of the time under way, or of the recording, without a sensor that is a finding.
MOST = 0.5


@dataclass(frozen=True)
class Outage:
    """A time without a sensor.

    Attributes:
        begin: Stamp of the last measurement before it, or where the time begins [s].
        end: Stamp of the first one after it, or where the time ends [s].
    """

    begin: float
    end: float

    @property
    def seconds(self) -> float:
        """How long it is [s]."""
        return self.end - self.begin


@dataclass
class Outages:
    """All of a replay.

    Attributes:
        dvl: Times without a DVL measurement that was used.
        imu: Times of the recording before the first and after the last sample.
        begin: When the recording begins, on the clock of the samples [s].
        recorded: How long it is [s].
        under_way: Time for which the vehicle was under way [s].
        lost: Of that without the DVL [s].
    """

    dvl: list[Outage] = field(default_factory=list)
    imu: list[Outage] = field(default_factory=list)
    begin: float = math.inf
    recorded: float = 0.0
    under_way: float = 0.0
    lost: float = 0.0

    @property
    def numbers(self) -> dict[str, Any]:
        """For the JSON document."""
        return {
            "count": len(self.dvl),
            "seconds": sum(outage.seconds for outage in self.dvl),
            "longest": max((outage.seconds for outage in self.dvl), default=0.0),
            "under_way": self.under_way,
            "lost_under_way": self.lost,
        }


def outages_of(replayed: Replayed) -> Outages:
    """All times without IMU or DVL that are worth a warning."""
    found = Outages()
    for part in replayed.parts:
        refused_ns = [
            stamp_ns
            for key, stamps_ns in part.refused_ns.items()
            if replayed.measurements.get(key.topic) == Dvl.name
            for stamp_ns in stamps_ns
        ]
        _add(found, part, refused_ns)
    return found


def _add(found: Outages, part: Part, refused_ns: list[int]) -> None:
    """Those between two time jumps, with DVL messages that were refused before they were judged."""
    if not part.size:
        return
    first, last, (before, after) = part.first_ns / NS, part.last_ns / NS, part.silent
    found.begin = min(found.begin, first - before)
    found.recorded += before + last - first + after
    silent = (Outage(first - before, first), Outage(last, last + after))
    found.imu += [outage for outage in silent if outage.seconds > OUTAGE]
    if part.known_ns is None:
        return
    lost = list(_without_dvl(part, refused_ns, *part.known_ns))
    found.dvl += lost
    times, speeds = np.array(part.pace.times_ns) / NS, np.array(part.pace.speeds)
    end = part.known_ns[1] / NS
    # While the state is not known there is no pace.
    seconds = np.minimum(np.diff(times, append=end), 2.0)
    moves, without = speeds > AT_REST, np.zeros(len(times), bool)
    for outage in lost:
        # Without the DVL the speed drifts: it is known before, and behind where there is a ping.
        k, m = np.searchsorted(times, [outage.begin, outage.end])
        behind = moves[m : m + 1] if outage.end < end else moves[:0]
        is_under_way = moves[max(k - 1, 0) : k + 1].any() or behind.any()
        without[k:m], moves[k:m] = True, is_under_way
    found.under_way += float(seconds[moves].sum())
    found.lost += float(seconds[moves & without].sum())


def _without_dvl(
    part: Part, refused_ns: list[int], first_ns: int, last_ns: int
) -> Iterator[Outage]:
    """Times between two used measurements that are too long, while the state was known."""
    pings = [u for u in part.updates if u.report.measurement == Dvl.name]
    came_ns = np.unique([ping.stamp_ns for ping in pings] + refused_ns)
    usual = float(np.median(np.diff(came_ns))) / NS if len(came_ns) > 1 else 0.0
    used_ns = [ping.stamp_ns for ping in pings if ping.report.accepted]
    ends_ns = [first_ns, *(t for t in used_ns if first_ns < t < last_ns), last_ns]
    for begin_ns, end_ns in pairwise(ends_ns):
        if end_ns - begin_ns > max(OUTAGE, PAUSES * usual) * NS:
            yield Outage(begin_ns / NS, end_ns / NS)


def of_imu_outages(outages: Outages) -> Iterator[Finding]:
    """An IMU that is missing for too long: measurements after its end are refused for that."""
    silent = sum(outage.seconds for outage in outages.imu)
    if silent >= min(LOST, MOST * outages.recorded) and silent > 0.0:
        yield Finding(
            "imu_outage",
            f"the IMU is missing for {silent:.0f} of {outages.recorded:.0f} s "
            f"({_times(outages.imu, outages.begin)}), and there is no result without it",
            "look for why its driver stopped",
        )


def of_dvl_outages(outages: Outages) -> Iterator[Finding]:
    """A DVL that is lost for too long to trust the position."""
    if outages.lost > MOST * outages.under_way:
        yield Finding(
            "dvl_outage",
            f"the DVL was not used for {outages.lost:.0f} of {outages.under_way:.0f} s under way "
            f"({_times(outages.dvl, outages.begin)}): the position is that of the IMU alone",
            "look for why its driver stopped, or why it has no bottom lock",
        )


def _times(outages: Sequence[Outage], begin: float) -> str:
    """The longest of them, from when to when [s]."""
    longest = max(outages, key=lambda outage: outage.seconds)
    text = f"from {longest.begin - begin:.0f} to {longest.end - begin:.0f} s"
    return text if len(outages) == 1 else f"{len(outages)} times, the longest {text}"
