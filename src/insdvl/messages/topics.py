"""The table of topics: each with its message types, its converter, and when it is taken.

The filter node, the replay, the simulator, the relay, the fault flights and the tests all read this
table. A new sensor is a row here, beside its measurement (navigation/measurements/), its parameters
(navigation/parameters.py) and its converter (convert.py, or a file of its own).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from operator import attrgetter
from types import MappingProxyType
from typing import Any

from insdvl.messages import convert, depth, drivers, dvl, heading
from insdvl.messages.convert import RejectedMessage
from insdvl.navigation.events import Event, Initial
from insdvl.navigation.geometry.frames import CONVENTIONS, Convention
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError

#: Names of the topics; a namespace or a remap may precede or replace them.
IMU = "imu/data_raw"
DVL = "dvl/velocity"
DVL_WITH_COVARIANCE = "dvl/velocity_cov"
SET_ODOMETRY = "set_odometry"
TRUTH = "ground_truth/odometry"
PROCESS_NOISE = "process_noise"
TRUE_PROCESS_NOISE = "ground_truth/process_noise"
MEASUREMENT_NOISE = "measurement_noise"
TRUE_MEASUREMENT_NOISE = "ground_truth/measurement_noise"
FIX = "gps/fix"
DEPTH = "depth/pressure"
HEADING = "heading/orientation"
#: Of what the filter publishes, as replay and node do: the estimate in odom and, where an input is
#: absolute, in map; and its place on the Earth.
ODOMETRY = "odometry/filtered"
GLOBAL_ODOMETRY = "odometry/global"
GLOBAL_POSITION = "gps/filtered"
BIAS = "imu/bias"
#: The end of the topic of a measurement's innovation, after the name of the measurement.
INNOVATION = "/innovation"
#: How topics of our nodes end that have the types of sensors and are none.
NO_SENSORS = (
    PROCESS_NOISE,
    MEASUREMENT_NOISE,
    SET_ODOMETRY,
    ODOMETRY,
    GLOBAL_ODOMETRY,
    GLOBAL_POSITION,
    BIAS,
    INNOVATION,
)

#: Topic of each source of process noise that has one.
Q_TOPICS: Mapping[str, str] = MappingProxyType(
    {"external": PROCESS_NOISE, "oracle": TRUE_PROCESS_NOISE}
)


class ZeroStamp(Enum):
    """What a stamp of zero means."""

    UNSET = auto()  # the driver does not stamp its messages: the converter refuses them
    BEGINNING = auto()  # the beginning of time, as in a simulation; refused once time is far on
    NOW = auto()  # the stamp of the newest IMU sample; less than zero is so long before it


#: The events of a message, in the order in which the filter takes them.
Converter = Callable[[Any, FilterParameters], Iterator[Event]]
_NO_FRAMES: Mapping[str, str] = MappingProxyType({})


def _always(parameters: FilterParameters) -> bool:
    return True


def _never(parameters: FilterParameters) -> str:
    return ""


@dataclass(frozen=True)
class Topic:
    """A row of the table.

    Attributes:
        name: Of the topic. Where a parameter names the topic, the name that our own nodes use.
        types: Message types that are accepted, ``package/msg/Name``; our own nodes publish the
            first. Which one a topic has is found in the recording or on the graph.
        convert: Message and parameters to events; raises `RejectedMessage`.
        refusals: Reasons for which `convert` may refuse a message.
        measurement: Which measurement the topic feeds: its name in ``UpdateReport.measurement``;
            empty for none.
        command: Whether every message must arrive: subscribed reliably. A sensor is subscribed
            with best effort, so that every driver matches.
        single: Whether the topic should have one publisher only.
        parameter: Dotted name of the filter's parameter that names the topic, such as
            ``depth.topic``; empty where the topic is always `name`.
        taken: Whether the filter with these parameters takes the topic.
        required: Why there is no result without the topic; empty where there is one.
        joins: Name of the topic whose messages it may take as well, where a parameter names that:
            one message then has the events of both.
        frames: Frame fields of the message, each with the filter's parameter that it must equal.
            A parameter that is empty accepts any frame, and a command may leave its frames empty.
        zero_stamp: What a stamp of zero means.
        time_offset: Dotted name of the filter's parameter [s] that is added to the stamps; empty
            where there is none.
        until_started: Whether messages are taken only until the filter has started, and max_delay
            has passed since.
        type_parameter: Dotted name of the filter's parameter that names the one type which is
            accepted, or is ``auto`` for all of them; empty where there is none.
        replay_parameter: Parameter of the replay that names the topic in a recording; empty where
            it is recorded under the name that the filter's parameter gives.
    """

    name: str
    types: tuple[str, ...]
    convert: Converter
    refusals: tuple[str, ...]
    measurement: str = ""
    command: bool = False
    single: bool = True
    parameter: str = ""
    taken: Callable[[FilterParameters], bool] = _always
    required: Callable[[FilterParameters], str] = _never
    joins: str = ""
    frames: Mapping[str, str] = field(default_factory=lambda: _NO_FRAMES)
    zero_stamp: ZeroStamp = ZeroStamp.UNSET
    time_offset: str = ""
    until_started: bool = False
    type_parameter: str = ""
    replay_parameter: str = ""

    def name_in(self, parameters: FilterParameters) -> str:
        """The topic's name with these parameters."""
        return str(attrgetter(self.parameter)(parameters)) if self.parameter else self.name

    def types_in(self, parameters: FilterParameters) -> tuple[str, ...]:
        """The types that are accepted with these parameters."""
        kind = attrgetter(self.type_parameter)(parameters) if self.type_parameter else "auto"
        return self.types if kind == "auto" else (str(kind),)


# ---------------------------------------------------------------- converters


def _convention(parameters: FilterParameters) -> Convention:
    return CONVENTIONS[parameters.frame_convention]


def orientation_sigma(parameters: FilterParameters) -> float:
    """One sigma of a heading of the IMU whose own is unknown [rad]; zero leaves such a one out."""
    return parameters.initial.heading_std if parameters.initial.heading == "imu" else 0.0


def _imu(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield convert.imu(message, _convention(parameters))
    if parameters.initial.takes_orientation:
        sigma = orientation_sigma(parameters)
        orientation = convert.orientation(message, _convention(parameters), sigma)
        if orientation is not None:
            yield orientation
    if parameters.process_noise.source == "message":
        yield convert.process_noise(message, _convention(parameters))


def _dvl(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    by_arrival = parameters.dvl.stamp == "arrival"
    yield dvl.dvl(message, _convention(parameters), by_arrival=by_arrival)


def _depth(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield depth.depth(message, _convention(parameters), parameters.depth)


def _heading(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield heading.heading(message, parameters, parameters.heading.mount)


def _imu_and_heading(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield from _imu(message, parameters)
    try:
        yield heading.heading(message, parameters, parameters.imu.mount)
    except RejectedMessage as rejection:  # the sample is used
        rejection.measurement = heading.Heading.name
        raise


def _process_noise(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield convert.process_noise(message, _convention(parameters))


def _measurement_noise(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield convert.measurement_noise(message, _convention(parameters), Dvl.name)


def _initial(message: Any, parameters: FilterParameters, *, once: bool) -> Initial:
    event = convert.initial(message, _convention(parameters), once=once)
    sigma = parameters.initial
    return replace(
        event,
        P_v=convert.completed(event.P_v, [sigma.velocity_std] * 3),
        P_psi=convert.completed(event.P_psi, sigma.attitude_std),
        P_p=convert.completed(event.P_p, [sigma.position_std] * 3),
    )


def _set_odometry(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield _initial(message, parameters, once=False)


def _first_odometry(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield _initial(message, parameters, once=True)


def _fix(message: Any, parameters: FilterParameters) -> Iterator[Event]:
    yield convert.origin(message, parameters.origin.height)


# ---------------------------------------------------------------- the table

_OF_IMU = ("bad_stamp", "no_stamp", "not_finite", "no_data", "bad_covariance")
_OF_ODOMETRY = ("bad_stamp", "not_finite", "bad_quaternion", "no_data", "bad_covariance")
_OF_PROCESS_NOISE = ("bad_stamp", "bad_covariance")
_OF_FIX = ("bad_stamp", "no_data", "not_finite", "out_of_range")
_DVL_FRAMES: Mapping[str, str] = MappingProxyType({"header.frame_id": "dvl.frame_id"})


def _of_source(topic: str, source: str, replay_parameter: str) -> Topic:
    """The topic of a source of process noise: taken, and required, where that source is set."""

    def taken(parameters: FilterParameters) -> bool:
        return parameters.process_noise.source == source

    def required(parameters: FilterParameters) -> str:
        return f"process_noise.source is '{source}'"

    return Topic(
        topic,
        (convert.IMU,),
        _process_noise,
        _OF_PROCESS_NOISE,
        command=True,
        taken=taken,
        required=required,
        zero_stamp=ZeroStamp.BEGINNING,
        time_offset="imu.time_offset",  # it has the stamps of the samples that it is of
        replay_parameter=replay_parameter,
    )


def _of_dvl_noise(
    topic: str,
    sources: tuple[str, ...],
    replay_parameter: str,
    required: Callable[[FilterParameters], str] = _never,
) -> Topic:
    """The topic of a covariance of the DVL's noise: taken with these of its sources."""
    return Topic(
        topic,
        (convert.TWIST_WITH_COVARIANCE,),
        _measurement_noise,
        ("bad_stamp", "no_data", "bad_covariance"),
        command=True,
        taken=lambda parameters: parameters.dvl.noise_source in sources,
        required=required,
        frames=_DVL_FRAMES,
        zero_stamp=ZeroStamp.BEGINNING,
        time_offset="dvl.time_offset",  # it has the stamps of the measurements that it is of
        replay_parameter=replay_parameter,
    )


#: In the order in which a stamp's measurements are used.
TOPICS: tuple[Topic, ...] = (
    Topic(
        IMU,
        (convert.IMU,),
        _imu,
        _OF_IMU,
        frames=MappingProxyType({"header.frame_id": "imu.frame_id"}),
        time_offset="imu.time_offset",
        replay_parameter="imu_topic",
    ),
    Topic(
        DVL,
        drivers.TYPES,
        _dvl,
        drivers.REFUSALS,
        measurement="dvl",
        frames=_DVL_FRAMES,
        zero_stamp=ZeroStamp.NOW,
        time_offset="dvl.time_offset",
        type_parameter="dvl.type",
        replay_parameter="dvl_topic",
    ),
    Topic(
        DVL_WITH_COVARIANCE,
        (convert.TWIST_WITH_COVARIANCE,),
        _dvl,
        drivers.DRIVERS[convert.TWIST_WITH_COVARIANCE].refusals,
        measurement="dvl",
        frames=_DVL_FRAMES,
        zero_stamp=ZeroStamp.NOW,
        time_offset="dvl.time_offset",
        replay_parameter="dvl_covariance_topic",
    ),
    Topic(
        DEPTH,
        depth.TYPES,
        _depth,
        (
            "bad_stamp",
            "no_stamp",
            "not_finite",
            "bad_covariance",
            "no_data",
            "out_of_range",
            "in_air",
        ),
        measurement="depth",
        parameter="depth.topic",
        taken=lambda parameters: bool(parameters.depth.topic),
        frames=MappingProxyType({"header.frame_id": "depth.frame_id"}),
        time_offset="depth.time_offset",
    ),
    Topic(
        HEADING,
        heading.TYPES,
        _heading,
        heading.REFUSALS,
        measurement="heading",
        parameter="heading.topic",
        taken=lambda parameters: bool(parameters.heading.topic),
        joins=IMU,
        frames=MappingProxyType({"header.frame_id": "heading.frame_id"}),
        time_offset="heading.time_offset",
    ),
    Topic(
        SET_ODOMETRY,
        (convert.ODOMETRY,),
        _set_odometry,
        _OF_ODOMETRY,
        command=True,
        single=False,
        required=lambda parameters: (
            "initial.mode is 'set_odometry'" if parameters.initial.mode == "set_odometry" else ""
        ),
        frames=MappingProxyType({"header.frame_id": "odom_frame", "child_frame_id": "base_frame"}),
        zero_stamp=ZeroStamp.NOW,
        replay_parameter="set_odometry_topic",
    ),
    Topic(
        TRUTH,
        (convert.ODOMETRY,),
        _first_odometry,
        _OF_ODOMETRY,
        single=False,
        parameter="initial.topic",
        taken=lambda parameters: parameters.initial.mode == "topic",
        required=lambda parameters: "initial.mode is 'topic'",
        zero_stamp=ZeroStamp.BEGINNING,
        until_started=True,
        replay_parameter="ground_truth_topic",
    ),
    _of_source(PROCESS_NOISE, "external", "process_noise_topic"),
    _of_source(TRUE_PROCESS_NOISE, "oracle", "true_process_noise_topic"),
    _of_dvl_noise(MEASUREMENT_NOISE, ("adaptive", "learned"), "measurement_noise_topic"),
    _of_dvl_noise(
        TRUE_MEASUREMENT_NOISE,
        ("oracle",),
        "true_measurement_noise_topic",
        lambda parameters: "dvl.noise_source is 'oracle'",
    ),
    Topic(
        FIX,
        (convert.FIX,),
        _fix,
        _OF_FIX,
        single=False,
        taken=lambda parameters: parameters.origin.source == "topic",
        required=lambda parameters: "origin.source is 'topic'",
        zero_stamp=ZeroStamp.BEGINNING,
        replay_parameter="fix_topic",
    ),
)

#: The rows by their names.
BY_NAME: Mapping[str, Topic] = MappingProxyType({topic.name: topic for topic in TOPICS})


def measurement_of(name: str) -> str:
    """Which measurement a topic of the table feeds; empty for none, and for any other topic."""
    return BY_NAME[name].measurement if name in BY_NAME else ""


def taken(parameters: FilterParameters) -> dict[str, Topic]:
    """The topics that a filter with these parameters takes, by their names with these parameters.

    Raises:
        ParameterError: A parameter names a topic that has another use already.
    """
    found: dict[str, Topic] = {}
    for topic in TOPICS:
        if not topic.taken(parameters):
            continue
        name = topic.name_in(parameters)
        same = [other for other in found if other.lstrip("/") == name.lstrip("/")]
        if same and topic.joins == found[same[0]].name:
            found[same[0]] = _joined(found[same[0]], topic)
        elif same:
            raise ParameterError(
                f"parameter '{topic.parameter}' must be a topic of its own, got {name!r}: "
                f"it is already used as {found[same[0]].parameter or found[same[0]].name}"
            )
        else:
            found[name] = replace(topic, types=topic.types_in(parameters))
    return found


def _joined(imu: Topic, sensor: Topic) -> Topic:
    """The IMU's topic, whose messages have a measurement of a sensor as well."""
    return replace(imu, convert=_imu_and_heading, measurement=sensor.measurement)
