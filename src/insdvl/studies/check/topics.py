"""Which topic of a recording is which sensor: as the parameters say, else by type and name."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from insdvl.messages import convert, depth
from insdvl.messages.topics import TOPICS, Topic
from insdvl.navigation.parameters import FilterParameters
from insdvl.recordings.bag_reader import RecordedTopic
from insdvl.recordings.base import typestore
from insdvl.recordings.parameters import ReplayParameters

#: Ends of the names of topics that filters, tuners and simulators publish: they are no sensors.
_NOT_SENSORS = ("process_noise", "bias", "filtered", "cmd_vel", "set_odometry")


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
        rivals: Further topics of the types of IMU and DVL.
    """

    imu: str
    dvl: str
    dvl_row: Topic | None
    pressure: str
    fix: str
    odometry: str
    rivals: tuple[str, ...]

    @property
    def uses(self) -> dict[str, str]:
        """What each topic is used as."""
        pairs = (
            (self.imu, "IMU"),
            (self.dvl, "DVL"),
            (self.pressure, "depth"),
            (self.fix, "fix"),
            (self.odometry, "odom"),
        )
        return {topic: use for topic, use in pairs if topic}


def sensors_of(
    topics: Mapping[str, RecordedTopic], filter_: FilterParameters, replay: ReplayParameters
) -> Sensors:
    """The sensors of a recording."""

    def chosen(types: Collection[str], word: str, *named: str) -> str:
        fitting = [name for name, topic in topics.items() if topic.size and topic.type in types]
        for name in named:
            if name in fitting:
                return name
        fitting = [name for name in fitting if not _is_no_sensor(name)]
        return max(
            fitting,
            key=lambda n: (word in n.lower(), topics[n].size, "raw" in n, n),
            default="",
        )

    rows = dvl_rows()
    types = [kind for row in rows for kind in row.types]
    dvl = chosen(types, "dvl", *(getattr(replay, row.replay_parameter) for row in rows))
    imu = chosen([convert.IMU], "imu", replay.imu_topic)
    return Sensors(
        imu=imu,
        dvl=dvl,
        dvl_row=next((row for row in rows if dvl and topics[dvl].type in row.types), None),
        pressure=chosen([depth.PRESSURE], "press", "/" + filter_.depth.topic.lstrip("/")),
        fix=chosen([convert.FIX], "fix", replay.fix_topic),
        odometry=chosen([convert.ODOMETRY], "truth", replay.ground_truth_topic),
        rivals=tuple(
            name
            for name, topic in topics.items()
            if topic.type in (convert.IMU, *types) and name not in (imu, dvl) and topic.size
            if not _is_no_sensor(name)
        ),
    )


def _is_no_sensor(name: str) -> bool:
    return any(name.endswith(end) or f"{end}/" in name for end in _NOT_SENSORS)


#: The types of the table: of other topics the index is enough.
READ = frozenset(kind for row in TOPICS for kind in row.types)


def begins_with_header(kind: str) -> bool:
    """Whether messages of a standard type begin with a header, and so with their stamp."""
    fields = typestore().fielddefs[kind][1] if kind in typestore().fielddefs else []
    return bool(fields) and fields[0][0] == "header"
