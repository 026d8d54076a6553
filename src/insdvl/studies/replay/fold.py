"""A recording through the core filter: the state that the filter node reaches, to the bit.

The fold keeps a few seconds of states. What has become final is given to those who need it
(`Consumer`), so a recording of hours takes no more memory than what they keep.
"""

from array import array
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from insdvl.messages.cdr.imu_bytes import decode_imus
from insdvl.messages.convert import ImuSamples
from insdvl.messages.feed import Fed, Feed
from insdvl.messages.refusals import NO_SAMPLE, Refused
from insdvl.messages.topics import IMU, taken
from insdvl.navigation.events import Event, Imu, Measurement
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.base import BagError, Raw, decode
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import Listed, Recording, Stored
from insdvl.studies.replay.consumer import Consumer
from insdvl.studies.replay.part import Part
from insdvl.studies.replay.reference import AtReference, Reference, reference_of
from insdvl.studies.replay.taken import Taken
from insdvl.timeline.fold import Fold
from insdvl.timeline.jumps import MAX_SUSPECTS
from insdvl.timeline.output import AppliedUpdate
from insdvl.watch.alignment.check import AlignmentCheck

#: Limit of the samples of a recording: 28 hours at 100 Hz.
MAX_SAMPLES = 10_000_000
#: Messages after which the states that have become final are taken.
BATCH = 512


def read(
    path: Path, parameters: ReplayParameters, filter_parameters: FilterParameters | None = None
) -> Stored:
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
    topics = taken(filter_parameters) if filter_parameters else {}
    return Stored(path, parameters, topics, MAX_SAMPLES)


@dataclass(frozen=True)
class Replayed:
    """A folded recording.

    Attributes:
        fold: The filter's timeline at the end, with the states of the last seconds.
        parts: What was folded between time jumps, in the order of arrival.
        messages: Number of messages that the filter was given, by topic.
        refused: Messages that were not used, by topic and reason, without those that the fold used
            after all; with the reason `NO_SAMPLE`, measurements that were never reached.
        measurements: Name of the measurement of each topic that feeds one.
        findings: Contradictions of the frames, see `AlignmentCheck`.
        has_map: Whether the filter has a map, see `Feed`.
        taken: The events of the last part.
        ping_noise: Noise of the DVL from ping to ping, see `AlignmentCheck.ping_noise`; of the last
            part.
        at_reference: Reference and states of the last part.
    """

    fold: Fold
    parts: Sequence[Part]
    messages: Counter[str]
    refused: Counter[Refused]
    measurements: Mapping[str, str]
    findings: list[str]
    has_map: bool
    taken: Taken
    ping_noise: tuple[float, float] | None
    at_reference: AtReference

    @property
    def last(self) -> Part:
        """The part after the last time jump."""
        return self.parts[-1]

    @property
    def updates(self) -> list[AppliedUpdate]:
        """The measurements of all parts."""
        return [update for part in self.parts for update in part.updates]


def feed_recording(recording: Recording, feed: Feed) -> Iterator[list[Fed]]:
    """The events of each message that the filter takes, in the recorded order.

    Raises:
        BagError: The recording lacks a topic that the parameters require, or a message is damaged.
    """
    names = _names(recording, feed)
    for raw in recording.on(names):
        yield feed.give(names[raw.topic], decode(raw).message)


def _names(recording: Recording, feed: Feed) -> dict[str, str]:
    """The filter's names of the topics that it takes, by those of the recording.

    Raises:
        BagError: The recording lacks a topic that the parameters require.
    """
    for topic, reason in feed.inputs.required.items():
        if topic.lstrip("/") not in recording.topics:
            raise BagError(f"{reason}, but nothing in the recording is played on {topic}")
    return {topic.lstrip("/"): topic for topic in feed.inputs.topics}


def fold_recording(
    recording: Recording | Sequence[Raw],
    parameters: FilterParameters,
    consumers: Iterable[Consumer] = (),
) -> Replayed:
    """All messages of a recording through the filter.

    Args:
        recording: On the topics of the nodes.
        parameters: Of the filter.
        consumers: Take messages and states.

    Raises:
        BagError: See `feed_recording`.
        ParameterError: Two parameters name one topic.
    """
    if not isinstance(recording, Recording):
        recording = Listed(recording)
    refused: list[Refused] = []

    def note(topic: str, reason: str, detail: str) -> None:
        refused.append(Refused(topic, reason))

    feed = Feed(parameters, capacity=4 * BATCH, on_refused=note)
    reference = Reference(*reference_of(recording))
    receivers = [reference, *consumers]
    for receiver in receivers:
        receiver.begin(feed)
    folding = _Folding(feed, parameters, receivers, refused)
    names = _names(recording, feed)
    messages = iter(recording)
    while batch := list(islice(messages, BATCH)):
        for receiver in receivers:
            receiver.messages(batch)
        folding.add(batch, names)
    folding.take(end=True)
    folding.account()
    folding.checks[-1].finish()
    topics = feed.inputs.topics.items()
    return Replayed(
        fold=feed.fold,
        parts=folding.parts,
        messages=folding.messages,
        refused=folding.refused,
        measurements={name: topic.measurement for name, topic in topics if topic.measurement},
        findings=list(dict.fromkeys(f for check in folding.checks for f in check.findings())),
        has_map=feed.has_map,
        taken=folding.taken,
        ping_noise=folding.checks[-1].ping_noise(),
        at_reference=reference.result,
    )


class _Folding:
    """What goes on while a recording is folded.

    Args:
        feed: The filter.
        parameters: Of the filter.
        receivers: Take states.
        refused: What the feed has just refused.
    """

    def __init__(
        self,
        feed: Feed,
        parameters: FilterParameters,
        receivers: Sequence[Consumer],
        refused: list[Refused],
    ) -> None:
        self._feed, self._parameters, self._receivers = feed, parameters, receivers
        self._new = refused
        self._imu = next(name for name, row in feed.inputs.topics.items() if row.name == IMU)
        self._suspects: deque[tuple[Event, Refused, int]] = deque(maxlen=MAX_SUSPECTS)
        # Of the measurements that the fold took: stamps, times of recording; by topic and name.
        self._measured: dict[tuple[str, str], tuple[array[int], array[int]]] = {}
        self.messages: Counter[str] = Counter()
        self.parts = [Part(feed.fold.filter)]
        self.checks = [AlignmentCheck(parameters, thinks=False)]  # one for each part
        self.taken = Taken()

    def add(self, batch: Sequence[Raw], names: Mapping[str, str]) -> None:
        """Feed the messages that follow: runs of samples at once, the others one by one.

        Args:
            batch: The messages.
            names: The filter's names of the topics that it takes.
        """
        fed, of_imu = [raw for raw in batch if raw.topic in names], names[IMU]
        data = [raw.data for raw in fed if raw.topic == IMU]
        others = [k for k, raw in enumerate(fed) if raw.topic != IMU]
        samples = self._feed.inputs.imu_samples(of_imu, decode_imus(data))
        k = row = 0  # next message, and next of the IMU
        for end in [*others, len(fed)]:
            while k < end:
                count = self._feed.give_samples(of_imu, samples, slice(row, row + end - k))
                self._took_samples(samples, slice(row, row + count))
                if count:
                    self._sampled(fed[k], fed[k + count - 1])
                if not count:
                    self._give(of_imu, fed[k])
                    count = 1
                k, row = k + count, row + count
            if k < len(fed):
                self._give(names[fed[k].topic], fed[k])
                k += 1
        self.messages.update(names[raw.topic] for raw in fed)
        self.take()

    def _sampled(self, first: Raw, last: Raw) -> None:
        self.parts[-1].sampled(self._feed.fold.newest_ns, first.time_ns, last.time_ns)

    def _took_samples(self, samples: ImuSamples, part: slice) -> None:
        if part.start == part.stop:
            return
        arrays = samples.stamps_ns[part], samples.f_b[part], samples.w_ib_b[part]
        self.checks[-1].add_samples(*arrays)
        self.taken.add_samples(*arrays)

    def _give(self, name: str, raw: Raw) -> None:
        self._new.clear()
        events = self._feed.give(name, decode(raw).message)
        self._account(name, events, raw.time_ns)
        if self._feed.fold.left:  # a time jump: these were of neither time
            self.take()
            self.checks[-1].finish()
            self.checks.append(AlignmentCheck(self._parameters, thinks=False))
            self.taken = Taken()
            return
        for event, refusal in events:
            if refusal is None:
                self.checks[-1].add(event)
                self.taken.add(event)
                if isinstance(event, Imu):
                    self._sampled(raw, raw)

    def _account(self, name: str, events: Sequence[Fed], time_ns: int) -> None:
        """Keep what became of a message, and withdraw the refusals that it has made void."""
        part = self.parts[-1]
        part.heard(time_ns)
        refused = iter([(key, part.refuse(key, time_ns)) for key in self._new])
        for event, refusal in events:
            if refusal is not None:
                self._suspects.append((event, *next(refused)))
            else:
                self._took(name, event, time_ns)
        recovered = {id(event) for event in self._feed.recovered}
        for event, key, came_ns in self._suspects if recovered else ():
            if id(event) in recovered:
                part.refused_ns[key].remove(came_ns)
                self._took(key.topic, event, time_ns)

    def _took(self, name: str, event: Event, time_ns: int) -> None:
        if isinstance(event, Measurement):
            # Of the IMU's messages each measurement is counted by its own name, see `Feed`.
            where = event.name if name == self._imu else name
            stamps_ns, times_ns = self._measured.setdefault(
                (where, event.name), (array("q"), array("q"))
            )
            stamps_ns.append(event.stamp_ns)
            times_ns.append(time_ns)

    def account(self) -> None:
        """At the end: what the fold took and never reached has waited for samples in vain."""
        reached = Counter(
            (update.report.measurement, update.stamp_ns)
            for part in self.parts
            for update in part.updates
        )
        last = self.parts[-1]
        for (topic, measurement), arrays in self._measured.items():
            for stamp_ns, time_ns in zip(*arrays, strict=True):
                if reached[measurement, stamp_ns]:
                    reached[measurement, stamp_ns] -= 1
                else:
                    last.refuse(Refused(topic, NO_SAMPLE), time_ns)

    @property
    def refused(self) -> Counter[Refused]:
        """Messages that were not used."""
        counts: Counter[Refused] = Counter()
        for part in self.parts:
            counts.update({key: len(times) for key, times in part.refused_ns.items() if times})
        return counts

    def take(self, *, end: bool = False) -> None:
        """Give on what has become final."""
        filter_ = self._feed.fold.filter
        for final in self._feed.fold.take_final(end=end):
            self.parts[-1].take(final)
            if len(final.states):
                for receiver in self._receivers:
                    receiver.take(filter_, final.states)
            if final.jump is not None:
                self.parts.append(Part(filter_))
            if final.jump is not None or end:
                for receiver in self._receivers:
                    receiver.end()
