"""Which topic of a recording is which sensor: as the parameters say, else by type and name."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

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
        rivals: Further topics of the types of IMU and DVL.
    """

    imu: str
    dvl: str
    dvl_row: Topic | None
    pressure: str
    fix: str
    odometry: str
    headings: tuple[str, ...]
    rivals: tuple[str, ...]

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

    def found(types: Collection[str], word: str, *names: str) -> str:
        """That, else the topic that is likeliest by its name, its number of messages next."""
        fitting = [name for name in _fitting(topics, types) if not _is_no_sensor(name)]
        return named(types, *names) or max(
            fitting, key=lambda n: (word in n.lower(), topics[n].size, "raw" in n, n), default=""
        )

    rows = dvl_rows()
    types = [kind for row in rows for kind in row.types]
    names = [getattr(replay, row.replay_parameter) for row in rows]
    dvls = [name for name in _fitting(topics, types) if _is_dvl(name, topics[name].type)]
    dvl = named(types, *names) or max(
        dvls,
        key=lambda n: (_WATER not in f"{n} {topics[n].type}".lower(), "dvl" in n, topics[n].size),
        default="",
    )
    imu = found([convert.IMU], "imu", replay.imu_topic)
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
        rivals=tuple(
            name
            for name in [*_fitting(topics, [convert.IMU]), *dvls]
            if name not in (imu, dvl) and not _is_no_sensor(name)
        ),
    )


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
