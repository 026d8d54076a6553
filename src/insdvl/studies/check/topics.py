"""Which topic of a recording is which sensor: as the parameters say, else by type and name."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from insdvl.messages import convert, depth
from insdvl.messages.topics import BY_NAME, HEADING, NO_SENSORS, TOPICS, Topic
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_reader import RecordedTopic
from insdvl.recordings.base import typestore
from insdvl.recordings.parameters import ReplayParameters

#: What a topic is used as.
IMU, DVL, DEPTH = "IMU", "DVL", "depth"
#: What the velocity through water is called by drivers that tell it as well.
_WATER = "water"
#: Ends of the names of further topics that filters and operators publish: they are no sensors.
_NOT_SENSORS = ("bias", "filtered", "cmd_vel")


def dvl_rows() -> tuple[Topic, ...]:
    """The rows of the table that feed the DVL."""
    return tuple(row for row in TOPICS if row.measurement == "dvl")


@dataclass(frozen=True)
class Sensors:
    """The recorded topics of the sensors, empty where there is none.

    Attributes:
        imu: Topic of the IMU.
        dvl: Topic of the DVL.
        dvl_row: How its type is read; None without a DVL.
        pressure: Topic of a pressure sensor.
        fix: Topic of a satellite fix.
        odometry: Topic of an odometry.
        headings: Topics of sensors that may tell the heading all the time.
        imu_rivals: Further topics that may be an IMU of this vehicle, or of another one.
        dvl_rivals: The same of the DVL.
    """

    imu: str
    dvl: str
    dvl_row: Topic | None
    pressure: str
    fix: str
    odometry: str
    headings: tuple[str, ...]
    imu_rivals: tuple[str, ...]
    dvl_rivals: tuple[str, ...]

    @property
    def uses(self) -> dict[str, str]:
        """What each topic is used as."""
        pairs = (
            (self.imu, IMU),
            (self.dvl, DVL),
            (self.pressure, DEPTH),
            (self.fix, "fix"),
            (self.odometry, "odom"),
        )
        return {topic: use for topic, use in pairs if topic}


def sensors_of(
    topics: Mapping[str, RecordedTopic], filter_: FilterParameters, replay: ReplayParameters
) -> Sensors:
    """The sensors of a recording."""

    def named(types: Collection[str], *names: str) -> str:
        """The first of the names that a parameter tells, where it has one of the types."""
        there = [n for n in names if n in topics and topics[n].size and topics[n].type in types]
        return there[0] if there else ""

    rows = dvl_rows()
    types = [kind for row in rows for kind in row.types]
    names = [getattr(replay, row.replay_parameter) for row in rows]
    imus = [name for name in _fitting(topics, [convert.IMU]) if not _is_no_sensor(name)]
    dvls = [name for name in _fitting(topics, types) if _is_dvl(name, topics[name].type)]
    told_imu, told_dvl = named([convert.IMU], replay.imu_topic), named(types, *names)
    imu, dvl = _pair(topics, [told_imu] if told_imu else imus, [told_dvl] if told_dvl else dvls)

    def found(types: Collection[str], word: str, *names: str) -> str:
        """That, else the likeliest by its name, by the vehicle, and by its number of messages."""
        fitting = [name for name in _fitting(topics, types) if not _is_no_sensor(name)]
        return named(types, *names) or max(
            fitting,
            key=lambda n: (word in n.lower(), _shared(n, dvl or imu), topics[n].size, n),
            default="",
        )

    odometry = found([convert.ODOMETRY], "truth", replay.ground_truth_topic)
    return Sensors(
        imu=imu,
        dvl=dvl,
        dvl_row=next((row for row in rows if dvl and topics[dvl].type in row.types), None),
        pressure=found([depth.PRESSURE], "press", "/" + filter_.depth.topic.lstrip("/")),
        fix=found([convert.FIX], "fix", replay.fix_topic),
        odometry=odometry if odometry != dvl else "",
        headings=tuple(
            name
            for name in _fitting(topics, set(BY_NAME[HEADING].types) - {convert.IMU})
            if not _is_no_sensor(name)
        ),
        imu_rivals=tuple(name for name in imus if name != imu),
        dvl_rivals=tuple(
            name
            for name in dvls
            if name not in (dvl, *names) and not _is_of_water(name, topics[name].type)
        ),
    )


def _pair(
    topics: Mapping[str, RecordedTopic], imus: Sequence[str], dvls: Sequence[str]
) -> tuple[str, str]:
    """IMU and DVL of one vehicle, empty where there is none.

    Two vehicles differ in the namespace, and a mixture of them navigates neither. Their names, and
    then the numbers of messages, decide between the sensors of one vehicle.
    """

    def likelihood(pair: tuple[str, str]) -> tuple[Any, ...]:
        imu, dvl = pair
        of_imu = ("imu" in imu.lower(), topics[imu].size, "raw" in imu, imu) if imu else ()
        of_dvl = ("dvl" in dvl.lower(), topics[dvl].size) if dvl else ()
        is_of_bottom = bool(dvl) and not _is_of_water(dvl, topics[dvl].type)
        return is_of_bottom, _shared(imu, dvl), of_imu, of_dvl

    return max(((i, d) for i in imus or [""] for d in dvls or [""]), key=likelihood)


def _shared(one: str, other: str) -> int:
    """Number of the parts of the namespace that two topics share: of a vehicle, not of a sensor."""
    parts = [name.lower().strip("/").split("/")[:-1] for name in (one, other)]
    vehicles = [list(takewhile(_is_no_device, names)) for names in parts]
    return sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(*vehicles, strict=False)))


def _is_no_device(part: str) -> bool:
    return "imu" not in part and "dvl" not in part


def _is_of_water(name: str, kind: str) -> bool:
    return _WATER in f"{name} {kind}".lower()


def _fitting(topics: Mapping[str, RecordedTopic], types: Collection[str]) -> list[str]:
    return [name for name, topic in topics.items() if topic.size and topic.type in types]


def _is_dvl(name: str, kind: str) -> bool:
    """Whether a topic of a type that a DVL may have is one: others have an odometry, too."""
    if _ends(name, NO_SENSORS):  # such as dvl/innovation
        return False
    return "dvl" in name.lower() or (kind != convert.ODOMETRY and not _is_no_sensor(name))


def _is_no_sensor(name: str) -> bool:
    return _ends(name, NO_SENSORS) or _ends(name, _NOT_SENSORS)


def _ends(name: str, ends: Collection[str]) -> bool:
    """Whether a topic, or one above it, ends so."""
    return any(name.endswith(end) or f"{end}/" in name for end in ends)


#: The types of the table: of other topics the index is enough.
READ = frozenset(kind for row in TOPICS for kind in row.types)


def begins_with_header(kind: str) -> bool:
    """Whether messages of a standard type begin with a header, and so with their stamp."""
    fields = typestore().fielddefs[kind][1] if kind in typestore().fielddefs else []
    return bool(fields) and fields[0][0] == "header"
