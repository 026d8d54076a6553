"""What went wrong in a replay, and when: refusals, outages, gaps, glitches, restarts, jumps."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from insdvl.messages.refusals import NO_SAMPLE
from insdvl.messages.topics import IMU
from insdvl.navigation.events import NS
from insdvl.studies.judgement.outages import outages_of
from insdvl.studies.replay.fold import Replayed
from insdvl.studies.replay.part import Part
from insdvl.watch.outages import OUTAGE

#: What happens again within this time is one incident [s].
TOGETHER = 5.0
#: At most so many incidents of one kind are told; the longest of them.
MOST = 200


@dataclass(frozen=True)
class Incident:
    """Something that went wrong.

    Attributes:
        name: Of a counter, or ``measurement refused: reason``, ``topic refused: reason``, ``time
            jump``, ``dvl outage`` or ``imu outage``.
        begin: Stamp [s].
        end: Stamp [s].
        count: How often.
    """

    name: str
    begin: float
    end: float
    count: int


def incidents_of(replayed: Replayed) -> list[Incident]:
    """All incidents in the order of their beginning."""
    found: list[Incident] = []
    for part in replayed.parts:
        for name, stamps_ns, counts in _of_part(part, replayed.measurements):
            found += _together(name, stamps_ns, counts)
    found += _jumps(replayed)
    outages = outages_of(replayed)
    for name, of_sensor in (("dvl outage", outages.dvl), ("imu outage", outages.imu)):
        found += [Incident(name, outage.begin, outage.end, 1) for outage in of_sensor]
    return sorted(found, key=lambda incident: incident.begin)


def _of_part(
    part: Part, measurements: Mapping[str, str]
) -> Iterator[tuple[str, list[int], list[int]]]:
    """Name, stamps and numbers of what happened at them."""
    for name, (stamps_ns, counts) in part.steps.items():
        yield name, stamps_ns, counts
    refused: dict[str, list[int]] = {}
    for update in part.updates:
        if not update.report.accepted and update.report.reason != "not_initialised":
            name = f"{update.report.measurement} refused: {update.report.reason}"
            refused.setdefault(name, []).append(update.stamp_ns)
    for key in part.refused_ns:
        came_ns = part.refused_ns[key].tolist()
        # The pings of the last moment wait for samples at the end of every recording.
        is_end = key.reason == NO_SAMPLE and part.silent[1] <= OUTAGE
        if not came_ns or is_end:
            continue
        sensor = key.topic if key.topic == IMU else measurements.get(key.topic, key.topic)
        refused.setdefault(f"{sensor} refused: {key.reason}", []).extend(came_ns)
    for name, stamps in refused.items():
        yield name, sorted(stamps), [1] * len(stamps)


def _together(name: str, stamps_ns: list[int], counts: list[int]) -> list[Incident]:
    """Neighbours in time as one incident."""
    if not stamps_ns:
        return []
    breaks = np.flatnonzero(np.diff(stamps_ns) > TOGETHER * NS) + 1
    found = [
        Incident(name, int(s[0]) / NS, int(s[-1]) / NS, int(c.sum()))
        for s, c in zip(
            np.split(np.array(stamps_ns), breaks), np.split(np.array(counts), breaks), strict=True
        )
    ]
    return sorted(found, key=lambda incident: incident.begin - incident.end)[:MOST]


def _jumps(replayed: Replayed) -> list[Incident]:
    """The beginning of each part but the first."""
    firsts = [part.first_ns / NS for part in replayed.parts[1:]]
    return [Incident("time jump", first, first, 1) for first in firsts]
