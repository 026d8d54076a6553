"""What of a recording is played, and as which topics of ours."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from insdvl.messages.topics import BY_NAME, DVL, IMU, TOPICS, Topic, measurement_of
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError, Raw
from insdvl.recordings.parameters import ReplayParameters

_NONE: Mapping[str, Topic] = MappingProxyType({})


def played(
    bag: BagReader, parameters: ReplayParameters, taken: Mapping[str, Topic] = _NONE
) -> dict[str, str]:
    """The recorded topics that are played, and the topics that the nodes know them by.

    Args:
        bag: The recording.
        parameters: Of the replay.
        taken: Topics of the filter, see `topics.taken`. One that the replay's parameters do not
            know is played from the recorded topic of its own name.

    Raises:
        BagError: A topic has another type, two parameters name one recorded topic, or the recording
            has no IMU or no DVL.
    """
    found: dict[str, str] = {}

    def play(parameter: str, recorded: str, topic: str, types: tuple[str, ...]) -> None:
        if not recorded or not bag.has(recorded, *types):
            return
        if (on := found.setdefault(recorded, topic)) != topic:
            joins = any(n.lstrip("/") == topic and row.joins == on for n, row in taken.items())
            remedy = f": set {parameter} to {on}, whose messages have both" if joins else ""
            raise BagError(f"{parameter} {recorded!r} is already played on {on}{remedy}")

    for row in TOPICS:
        if row.replay_parameter:
            recorded = getattr(parameters, row.replay_parameter)
            play(row.replay_parameter, recorded, row.name, taken.get(row.name, row).types)
    for name, row in taken.items():
        topic = name.lstrip("/")
        if topic != row.name or not row.replay_parameter:
            play(row.parameter, "/" + topic, topic, row.types)
    for name in parameters.further_topics:
        topic = name.lstrip("/")
        if topic and (recorded := "/" + topic) in bag.topics:
            play("further_topics", recorded, topic, (bag.topics[recorded].type,))
    bag.require(parameters.imu_topic, *BY_NAME[IMU].types)
    if not any(measurement_of(topic) == "dvl" for topic in found.values()):
        bag.require(parameters.dvl_topic, *BY_NAME[DVL].types)
    return found


class Recording(ABC, Iterable[Raw]):
    """Messages on topics of ours, in the recorded order; they may be iterated over repeatedly.

    None of them stays in memory: a recording of hours has gigabytes.
    """

    @property
    @abstractmethod
    def topics(self) -> frozenset[str]:
        """The topics that have messages."""

    @abstractmethod
    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """The messages on some topics.

        Raises:
            BagError: The recording is damaged.
        """

    def __iter__(self) -> Iterator[Raw]:
        return self.on(self.topics)


class Listed(Recording):
    """A recording of messages that are in memory."""

    def __init__(self, raws: Iterable[Raw]) -> None:
        self._raws = list(raws)

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return frozenset(raw.topic for raw in self._raws)

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        return (raw for raw in self._raws if raw.topic in topics)


class Stored(Recording):
    """What is played of a recording in a file.

    What a reader should know of it goes to stderr.

    Attributes:
        path: Its place.
        duration: As it tells it [s].

    Args:
        path: The recording.
        parameters: Of the replay.
        taken: Topics of the filter, which are played as well.
        most: Most samples of the IMU that are read.

    Raises:
        BagError: The recording cannot be read, has no IMU or no DVL, or is too long.
    """

    def __init__(
        self, path: Path, parameters: ReplayParameters, taken: Mapping[str, Topic], most: int
    ) -> None:
        self.path = path
        with BagReader(path) as bag:
            for remark in bag.remarks:
                print(f"{path}: {remark}", file=sys.stderr)
            self._played = played(bag, parameters, taken)
            self.duration = bag.duration
            size = bag.topics[parameters.imu_topic].size
        if size > most:
            raise BagError(
                f"{path} has {size} messages on {parameters.imu_topic}; at most {most} are "
                "read: split it"
            )

    @property
    def topics(self) -> frozenset[str]:
        """See `Recording`."""
        return frozenset(self._played.values())

    def on(self, topics: Collection[str]) -> Iterator[Raw]:
        """See `Recording`."""
        played = {name: topic for name, topic in self._played.items() if topic in topics}
        with BagReader(self.path) as bag:
            yield from bag.raw(played, played)
