"""Which topics of a recording are played, and as which topics of ours."""

from collections.abc import Mapping
from types import MappingProxyType

from insdvl.messages.topics import BY_NAME, DVL, IMU, TOPICS, Topic, measurement_of
from insdvl.recordings.bag_reader import BagReader
from insdvl.recordings.base import BagError
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
