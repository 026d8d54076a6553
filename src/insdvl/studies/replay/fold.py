"""A recording through the core filter: the state that the filter node reaches, to the bit."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insdvl.messages.feed import Fed, Feed
from insdvl.messages.refusals import Refused
from insdvl.messages.topics import IMU, taken
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError, Raw, decode
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import played
from insdvl.studies.replay.taken import Taken
from insdvl.timeline.fold import Fold
from insdvl.timeline.output import AppliedUpdate, FoldResult
from insdvl.watch.alignment.check import AlignmentCheck

#: Limit of the samples of a recording: 28 hours at 100 Hz. All states are in memory, 3 kB each.
MAX_SAMPLES = 10_000_000


def read(
    path: Path, parameters: ReplayParameters, filter_parameters: FilterParameters | None = None
) -> list[Raw]:
    """What is played of a recording, in the recorded order, on the topics of the nodes.

    What a reader should know of the recording goes to stderr.

    Args:
        path: The recording.
        parameters: Of the replay.
        filter_parameters: Of the filter; topics that they name are played as well.

    Raises:
        BagError: The recording cannot be read, has no IMU or no DVL, or is too long.
        ParameterError: Two parameters of the filter name one topic.
    """
    with BagReader(path) as bag:
        for remark in bag.remarks:
            print(f"{path}: {remark}", file=sys.stderr)
        topics = played(bag, parameters, taken(filter_parameters) if filter_parameters else {})
        size = bag.topics[parameters.imu_topic].size
        if size > MAX_SAMPLES:
            raise BagError(
                f"{path} has {size} messages on {parameters.imu_topic}; at most {MAX_SAMPLES} are "
                "read: split it"
            )
        return [raw._replace(topic=topics[raw.topic]) for raw in bag.raw(topics)]


@dataclass(frozen=True)
class Replayed:
    """A folded recording.

    Attributes:
        fold: With the states at all IMU stamps; those before a time jump are in ``fold.left``.
        refused: Messages that were not used, by topic and reason.
        measurements: Name of the measurement of each topic that feeds one.
        findings: Contradictions of the frames, see `AlignmentCheck`.
        has_map: Whether the filter has a map, see `Feed`.
        taken: The events of the last part.
        ping_noise: Noise of the DVL from ping to ping, see `AlignmentCheck.ping_noise`; of the last
            part.
    """

    fold: Fold
    refused: Counter[Refused]
    measurements: Mapping[str, str]
    findings: list[str]
    has_map: bool
    taken: Taken
    ping_noise: tuple[float, float] | None

    @property
    def initialised(self) -> NDArray[np.intp]:
        """Indices of the initialised states, after the last time jump."""
        return np.flatnonzero(self.fold.states["nav"]["initialised"])

    @property
    def parts(self) -> list[Fold | FoldResult]:
        """What was folded between time jumps, in the order of arrival."""
        return [*self.fold.left, self.fold]

    @property
    def updates(self) -> list[AppliedUpdate]:
        """The measurements of all parts."""
        return [update for part in self.parts for update in part.updates]


def feed_recording(recording: Sequence[Raw], feed: Feed) -> Iterator[list[Fed]]:
    """The events of each message that the filter takes, in the recorded order.

    Raises:
        BagError: The recording lacks a topic that the parameters require, or a message is damaged.
    """
    there = {raw.topic for raw in recording}
    for topic, reason in feed.inputs.required.items():
        if topic.lstrip("/") not in there:
            raise BagError(f"{reason}, but nothing in the recording is played on {topic}")
    names = {topic.lstrip("/"): topic for topic in feed.inputs.topics}
    for raw in recording:
        if raw.topic in names:
            yield feed.give(names[raw.topic], decode(raw).message)


def fold_recording(recording: Sequence[Raw], parameters: FilterParameters) -> Replayed:
    """All messages of a recording through the filter.

    Raises:
        BagError: See `feed_recording`.
        ParameterError: Two parameters name one topic.
    """
    feed = Feed(parameters, capacity=sum(raw.topic == IMU for raw in recording) + 1)
    checks = [AlignmentCheck(parameters)]  # one for each part
    taken_events = Taken()
    for events in feed_recording(recording, feed):
        if len(feed.fold.left) >= len(checks):
            checks.append(AlignmentCheck(parameters))
            taken_events = Taken()
            continue
        for event, refusal in events:
            if refusal is None:
                checks[-1].add(event)
                taken_events.add(event)
    findings = {finding: None for check in checks for finding in check.findings()}
    topics = feed.inputs.topics.items()
    measurements = {name: topic.measurement for name, topic in topics if topic.measurement}
    return Replayed(
        feed.fold,
        feed.refused,
        measurements,
        list(findings),
        feed.has_map,
        taken_events,
        checks[-1].ping_noise(),
    )
