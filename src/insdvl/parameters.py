"""Parameters: what every node and command can be told, declared once.

A group of parameters is a frozen dataclass whose fields are made by `parameter`, with unit, range
and meaning. From these come the ROS declarations and descriptors, the check of a YAML file, the
tables in docs/parameters.md and the example files. Groups nest; a nested field's full name is
joined by dots (``dvl.lever_arm``).

A value is accepted exactly as ROS 2 accepts it: types are strict (``5`` is not a float), a list is
of floats throughout. What is wrong is named, with its value and what is allowed.
"""

import dataclasses
import difflib
import math
import re
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from insdvl import yaml_files
from insdvl.files import beginning, shown

_Group = TypeVar("_Group")


class ParameterError(ValueError):
    """A parameter has an unknown name, a wrong type or a value out of its range."""


#: Largest size of a number with a unit, where its parameter has no bound of its own: more than any
#: vehicle, sensor or mission has, and little enough that squares and products stay finite.
WIDEST = MappingProxyType(
    {
        "s": 1e9,
        "m": 1e7,
        "m/s": 1e3,
        "m/s^2": 1e4,
        "rad": 2 * math.pi,
        "rad/s": 1e3,
        "(m/s^2)^2": 1e8,
        "(rad/s)^2": 1e6,
        "(m/s^2)^2/s": 1e8,
        "(rad/s)^2/s": 1e6,
    }
)


def parameter(
    default: Any,
    meaning: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    choices: tuple[str, ...] = (),
    length: int | None = None,
) -> Any:
    """A dataclass field that is a parameter.

    Args:
        default: The value when nothing is given; its type is the parameter's type. A tuple of
            floats or of strings is a list of them, and is not empty.
        meaning: One sentence.
        unit: SI unit of the value, empty for a plain number.
        low: Smallest value allowed, also of each element of a list; see WIDEST if not given.
        high: Largest value allowed, also of each element of a list; see WIDEST if not given.
        above: The value must be larger than this.
        choices: The strings allowed; empty for any.
        length: Number of elements of a list.
    """
    if unit in WIDEST:
        high = WIDEST[unit] if high is None else high
        low = -WIDEST[unit] if low is None and above is None else low
    metadata = {
        "meaning": meaning,
        "unit": unit,
        "low": low,
        "high": high,
        "above": above,
        "choices": choices,
        "length": length,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Declaration:
    """One parameter of a group, as ROS and the documentation need it."""

    name: str
    default: Any
    meaning: str
    unit: str
    low: float | None
    high: float | None
    above: float | None
    choices: tuple[str, ...]
    length: int | None

    @property
    def type_name(self) -> str:
        """``bool``, ``int``, ``float``, ``string``, ``list of floats`` or ``list of strings``."""
        names = {bool: "bool", int: "int", float: "float", str: "string"}
        if type(self.default) is tuple:
            return f"list of {names[type(self.default[0])]}s"
        return names[type(self.default)]

    @property
    def range_text(self) -> str:
        """What values are allowed, in words; empty where any is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        bounds = []
        if self.above is not None:
            bounds.append(f"> {self.above:g}")
        if self.low is not None:
            bounds.append(f">= {self.low:g}")
        if self.high is not None:
            bounds.append(f"<= {self.high:g}")
        text = " and ".join(bounds)
        if self.length is not None:
            text = f"{self.length} values" + (f", each {text}" if text else "")
        return text

    def check(self, value: Any) -> Any:
        """The value as the dataclass keeps it (lists become tuples).

        Raises:
            ParameterError: It has the wrong type or is outside the range.
        """
        if type(self.default) is tuple:
            if isinstance(value, str) or not hasattr(value, "__iter__"):
                raise self._wrong_type(value)
            elements = tuple(value)
            if any(type(element) is not type(self.default[0]) for element in elements):
                raise self._wrong_type(value)
            if self.length is not None and len(elements) != self.length:
                raise self._out_of_range(value)
            for element in elements:
                if type(element) is float and not self._allows(element):
                    raise self._out_of_range(value)
            return elements
        if type(value) is not type(self.default):
            raise self._wrong_type(value)
        if self.choices and value not in self.choices:
            raise self._out_of_range(value)
        if type(value) is str and "\0" in value:
            raise ParameterError(f"parameter '{self.name}' must have no NUL, got {shown(value)}")
        if type(value) is int and not -(2**63) <= value < 2**63:
            raise ParameterError(
                f"parameter '{self.name}' must fit into 64 bits, got {shown(value)}"
            )
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and not self._allows(value):
            raise self._out_of_range(value)
        return value

    def _allows(self, value: float) -> bool:
        return (
            math.isfinite(value)
            and (self.low is None or value >= self.low)
            and (self.high is None or value <= self.high)
            and (self.above is None or value > self.above)
        )

    def _wrong_type(self, value: Any) -> ParameterError:
        return ParameterError(
            f"parameter '{self.name}' must be a {self.type_name}, got {shown(value)} "
            f"({type(value).__name__})"
        )

    def _out_of_range(self, value: Any) -> ParameterError:
        return ParameterError(
            f"parameter '{self.name}' must be {self.range_text or 'finite'}, got {shown(value)}"
        )


def _check_frames(odom: str, base: str) -> None:
    """What is related by an odometry are two frames with names."""
    for name, frame in (("odom_frame", odom), ("base_frame", base)):
        if not frame:
            raise ParameterError(f"parameter '{name}' must not be empty")
    if odom == base:
        raise ParameterError(
            f"parameter 'base_frame' must be another one than odom_frame, got {shown(base)}"
        )


def declarations(group: type[Any], prefix: str = "") -> Iterator[Declaration]:
    """The parameters of a group, those of nested groups included, in their written order."""
    types = typing.get_type_hints(group)
    for item in dataclasses.fields(group):
        name = prefix + item.name
        if dataclasses.is_dataclass(types[item.name]):
            yield from declarations(types[item.name], name + ".")
        else:
            yield Declaration(name=name, default=item.default, **item.metadata)


def build(group: type[_Group], values: Mapping[str, Any], prefix: str = "") -> _Group:
    """A group from full names and values; what is not given takes its default.

    Raises:
        ParameterError: An unknown name, a wrong type, a value out of range or a contradiction.
    """
    known = {declaration.name: declaration for declaration in declarations(group, prefix)}
    for name in values:
        if name.startswith(prefix) and name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.0)
            raise ParameterError(
                f"unknown parameter {shown(name)}; the nearest are {', '.join(near)}"
            )
    return _build(group, values, known, prefix)


def _build(
    group: type[_Group], values: Mapping[str, Any], known: Mapping[str, Declaration], prefix: str
) -> _Group:
    types = typing.get_type_hints(group)
    arguments = {}
    for item in dataclasses.fields(group):  # type: ignore[arg-type]
        name = prefix + item.name
        if dataclasses.is_dataclass(types[item.name]):
            arguments[item.name] = _build(types[item.name], values, known, name + ".")
        elif name in values:
            arguments[item.name] = known[name].check(values[name])
    return group(**arguments)


def flatten(group: Any, prefix: str = "") -> dict[str, Any]:
    """Full names and values of a group; `build` makes the group again from them."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(group):
        value = getattr(group, item.name)
        if dataclasses.is_dataclass(value):
            values.update(flatten(value, prefix + item.name + "."))
        else:
            values[prefix + item.name] = value
    return values


def _mount(sensor: str) -> Any:
    """How a sensor is turned against the vehicle."""
    return parameter(
        (0.0, 0.0, 0.0),
        f"Rotation from {sensor} axes to base_link axes, as roll, pitch, yaw of the {sensor} in "
        "base_link.",
        unit="rad",
        low=-2 * math.pi,
        high=2 * math.pi,
        length=3,
    )


def _lever_arm(sensor: str) -> Any:
    """Where a sensor sits in the vehicle."""
    return parameter(
        (0.0, 0.0, 0.0),
        f"Position of the {sensor} in base_link.",
        unit="m",
        low=-1000.0,
        high=1000.0,
        length=3,
    )


@dataclass(frozen=True)
class ImuParameters:
    """The real IMU."""

    rate: float = parameter(
        100.0,
        "Nominal rate of the IMU; turns a variance per sample into a density.",
        unit="Hz",
        above=0.0,
        high=10_000.0,
    )
    mount: tuple[float, ...] = _mount("IMU")
    lever_arm: tuple[float, ...] = _lever_arm("IMU")
    frame_id: str = parameter(
        "", "A sample of any other frame_id is refused as 'wrong_frame'; empty for any."
    )
    max_gap: float = parameter(
        0.1,
        "An interval between IMU stamps longer than this is a gap: it is counted, bridged with "
        "the sample that ends it, and adds the uncertainty of the motion that was not seen.",
        unit="s",
        above=0.0,
    )
    gap_acceleration_std: float = parameter(
        0.5, "Acceleration that may go unseen in a gap, one sigma.", unit="m/s^2", low=0.0
    )
    gap_rate_std: float = parameter(
        0.05, "Rate of turn that may go unseen in a gap, one sigma.", unit="rad/s", low=0.0
    )
    acceleration_range: float = parameter(
        0.0,
        "A channel that reads this or more, either way, is saturated: the motion that it does not "
        "see is added as in a gap, this at least; 0 if no range is declared.",
        unit="m/s^2",
        low=0.0,
    )
    rate_range: float = parameter(
        0.0, "As acceleration_range, of the angular rate.", unit="rad/s", low=0.0
    )
    frozen_samples: int = parameter(
        100,
        "A channel with this many exactly equal samples in a row is frozen: it is taken for one "
        "that feels gravity only, or no turn, and the motion that it does not see is added as in a "
        "gap; 0 for never.",
        low=0,
        high=1_000_000,
    )


@dataclass(frozen=True)
class DvlParameters:
    """The real DVL and the error that is modelled of it."""

    frame_id: str = parameter(
        "", "A measurement of any other frame_id is refused as 'wrong_frame'; empty for any."
    )
    mount: tuple[float, ...] = _mount("DVL")
    lever_arm: tuple[float, ...] = _lever_arm("DVL")
    noise_std: tuple[float, ...] = parameter(
        (0.1, 0.1, 0.1),
        "Noise of each velocity component, one sigma; a covariance in the message replaces it.",
        unit="m/s",
        low=1e-6,
        length=3,
    )
    lock_check: bool = parameter(
        True,
        "Refuse a velocity of exactly zero ('no_lock') and one with exactly the bits of the "
        "measurement before it ('repeated'): what a DVL without bottom lock reports.",
    )
    gyro_average: float = parameter(
        0.25,
        "The turn rate for the lever arm is the mean over this time, ending at the stamp.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    bias_model: str = parameter(
        "none",
        "Model of the slowly varying DVL error, three more states when it is on.",
        choices=("none", "gauss_markov"),
    )
    bias_std: float = parameter(
        0.01, "Stationary sigma of the first-order Gauss-Markov error.", unit="m/s", low=0.0
    )
    bias_time_constant: float = parameter(
        10.0, "Correlation time of the first-order Gauss-Markov error.", unit="s", above=0.0
    )


@dataclass(frozen=True)
class GateParameters:
    """Which DVL measurements are used."""

    enabled: bool = parameter(True, "Reject DVL measurements that fail the chi-square gate.")
    probability: float = parameter(
        0.999,
        "Probability that a good measurement passes the gate.",
        above=0.5,
        high=1.0 - 1e-12,
    )
    max_rejection_time: float = parameter(
        60.0,
        "When nothing but rejections came for this time (in stamps), or for as long as the DVL has "
        "borne the filter out before if that is shorter (5 s at most where the filter may be wrong "
        "itself), the covariance of velocity and tilt is inflated; after twice the time the "
        "velocity is initialised again from the DVL.",
        unit="s",
        above=0.0,
        high=3600.0,
    )


@dataclass(frozen=True)
class ProcessNoiseParameters:
    """The process noise Q and where it comes from."""

    source: str = parameter(
        "constant",
        "Where Q comes from: the nominal values; the innovations; the process_noise topic; the "
        "covariances in imu/data_raw; the simulator's ground_truth/process_noise.",
        choices=("constant", "adaptive", "external", "message", "oracle"),
    )
    convention: str = parameter(
        "per_sample",
        "Whether a variance is per IMU sample (density = variance / imu.rate) or is itself used "
        "as the density.",
        choices=("per_sample", "density"),
    )
    accelerometer_variance: tuple[float, ...] = parameter(
        (0.01, 0.01, 0.01), "Nominal variance of each axis.", unit="(m/s^2)^2", low=0.0, length=3
    )
    gyroscope_variance: tuple[float, ...] = parameter(
        (0.001, 0.001, 0.001), "Nominal variance of each axis.", unit="(rad/s)^2", low=0.0, length=3
    )
    accelerometer_bias_walk: float = parameter(
        1e-9, "Density of the accelerometer bias walk.", unit="(m/s^2)^2/s", low=0.0
    )
    gyroscope_bias_walk: float = parameter(
        1e-13, "Density of the gyroscope bias walk.", unit="(rad/s)^2/s", low=0.0
    )
    accelerometer_floor: float = parameter(
        1e-8,
        "Smallest variance that an external or message Q may set; counted when it acts.",
        unit="(m/s^2)^2",
        low=0.0,
    )
    gyroscope_floor: float = parameter(
        1e-12,
        "Smallest variance that an external or message Q may set; counted when it acts.",
        unit="(rad/s)^2",
        low=0.0,
    )
    accelerometer_ceiling: float = parameter(
        100.0,
        "Largest variance that an external or message Q may set; counted when it acts.",
        unit="(m/s^2)^2",
        above=0.0,
        high=1e6,
    )
    gyroscope_ceiling: float = parameter(
        10.0,
        "Largest variance that an external or message Q may set; counted when it acts.",
        unit="(rad/s)^2",
        above=0.0,
        high=1e6,
    )
    adaptive_window: int = parameter(
        5, "Number of innovations averaged by the adaptive source (xi).", low=1, high=1000
    )
    adaptive_form: str = parameter(
        "floored",
        "What the adaptive source does: adds its estimate to the nominal Q; replaces Q by it; or "
        "leaves Q and estimates the predicted covariance at each update by variational Bayes.",
        choices=("floored", "literal", "variational"),
    )
    adaptive_prior: float = parameter(
        10.0,
        "Weight of the predicted covariance against one innovation, of the form 'variational' "
        "(tau).",
        above=0.0,
        high=1e6,
    )

    def __post_init__(self) -> None:
        for sensor in ("accelerometer", "gyroscope"):
            floor, ceiling = (getattr(self, f"{sensor}_{end}") for end in ("floor", "ceiling"))
            if floor > ceiling:
                raise ParameterError(
                    f"parameter 'process_noise.{sensor}_floor' must be at most {sensor}_ceiling "
                    f"({ceiling:g}), got {floor!r}"
                )


_GRAVITY = 9.9  # m/s^2, more than anywhere on the Earth

#: A topic's name as ROS 2 takes it.
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
#: Topics of the filter that have another type or another meaning, and its own output.
_NO_INITIAL_TOPIC = (
    "imu/data_raw",
    "dvl/velocity",
    "dvl/velocity_cov",
    "process_noise",
    "ground_truth/process_noise",
    "gps/fix",
    "set_odometry",
    "odometry/filtered",
)


@dataclass(frozen=True)
class InitialParameters:
    """The state at the start and its uncertainty."""

    mode: str = parameter(
        "parameters",
        "How the filter starts: from these values at the first IMU stamp; from the first message "
        "of initial.topic; levelled with the accelerometer; on set_odometry only.",
        choices=("parameters", "topic", "levelling", "set_odometry"),
    )
    topic: str = parameter("ground_truth/odometry", "Odometry topic of the mode 'topic'.")
    levelling_time: float = parameter(
        1.0, "Length of the mean specific force of the mode 'levelling'.", unit="s", above=0.0
    )
    position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "Position of base_link in odom.", unit="m", length=3
    )
    rpy: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "Roll, pitch, yaw of base_link in odom; 'levelling' uses the yaw only.",
        unit="rad",
        low=-2 * math.pi,
        high=2 * math.pi,
        length=3,
    )
    velocity: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "Velocity of base_link, in initial.velocity_frame.", unit="m/s", length=3
    )
    velocity_frame: str = parameter(
        "body",
        "Axes in which the velocity and its uncertainty are declared.",
        choices=("body", "nav"),
    )
    accelerometer_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "Bias of each axis, in IMU axes.", unit="m/s^2", length=3
    )
    gyroscope_bias: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "Bias of each axis, in IMU axes.", unit="rad/s", length=3
    )
    velocity_std: float = parameter(0.1, "One sigma of each axis.", unit="m/s", low=0.0)
    tilt_std: float = parameter(
        math.radians(0.5), "One sigma of roll and pitch.", unit="rad", low=0.0
    )
    heading_std: float = parameter(
        math.radians(1.0), "One sigma of the heading.", unit="rad", low=0.0
    )
    accelerometer_bias_std: float = parameter(
        1e-3, "One sigma of each axis.", unit="m/s^2", low=0.0
    )
    gyroscope_bias_std: float = parameter(1e-5, "One sigma of each axis.", unit="rad/s", low=0.0)
    position_std: float = parameter(0.1, "One sigma of each axis.", unit="m", low=0.0)

    @property
    def attitude_std(self) -> tuple[float, float, float]:
        """One sigma of the turns about north, east and down [rad]."""
        return self.tilt_std, self.tilt_std, self.heading_std

    def __post_init__(self) -> None:
        if not _TOPIC.fullmatch(self.topic) or self.topic.lstrip("/") in _NO_INITIAL_TOPIC:
            raise ParameterError(
                "parameter 'initial.topic' must be a topic that is none of "
                f"{', '.join(_NO_INITIAL_TOPIC)}, got {shown(self.topic)}"
            )


@dataclass(frozen=True)
class OriginParameters:
    """Where on the Earth the origin of odom is."""

    source: str = parameter(
        "parameters",
        "Whether odom's origin on the Earth is given here or is the first fix on gps/fix.",
        choices=("parameters", "topic"),
    )
    latitude_deg: float = parameter(
        32.0, "Geodetic latitude of the origin.", unit="deg", low=-90.0, high=90.0
    )
    longitude_deg: float = parameter(
        34.0, "Longitude of the origin.", unit="deg", low=-180.0, high=360.0
    )
    height: float = parameter(
        0.0, "Height of the origin above the ellipsoid.", unit="m", low=-12_000.0, high=100_000.0
    )


@dataclass(frozen=True)
class FilterParameters:
    """Parameters of the filter, for the node and for `insdvl replay`."""

    frame_convention: str = parameter(
        "enu",
        "Axes of all topics and of all vectors in these parameters: east-north-up and "
        "forward-left-up (REP-103), or north-east-down and forward-right-down.",
        choices=("enu", "ned"),
    )
    odom_frame: str = parameter("odom", "frame_id of the output.")
    base_frame: str = parameter("base_link", "child_frame_id of the output.")
    error_state: str = parameter(
        "invariant", "Coordinates of the velocity error.", choices=("invariant", "ned")
    )
    earth_rate: bool = parameter(True, "Model the rotation of the Earth.")
    max_delay: float = parameter(
        2.0,
        "A message older than the newest IMU stamp by more than this is counted and dropped.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    output_delay: float = parameter(
        0.0,
        "Odometry is published this long after its stamp, with all that arrived until then.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    jump_limit: float = parameter(
        30.0,
        "An IMU stamp that is ahead of the newest by more than this, or older than max_delay, is "
        "of another time; ten such samples in a row are a time jump. Measurements and Q may be "
        "ahead by as much, or by what 10,000 samples take where that is longer.",
        unit="s",
        low=1.0,
        high=3600.0,
    )
    jump_action: str = parameter(
        "reset",
        "At a time jump the filter starts again in the new time; or everything stays refused until "
        "stamps of the old time come again or ~/reset is called.",
        choices=("reset", "hold"),
    )
    q_timeout: float = parameter(
        5.0,
        "A Q from a topic older than this (in stamps) falls back to the nominal.",
        unit="s",
        above=0.0,
    )
    state_file: str = parameter(
        "",
        "File in which the node keeps its state; at its start it goes on from there if the first "
        "IMU stamp is at most jump_limit later. Empty for none; every filter needs its own.",
    )
    state_period: float = parameter(
        1.0,
        "How often state_file is written, in the time of the stamps; at most jump_limit.",
        unit="s",
        low=0.01,
        high=3600.0,
    )
    imu: ImuParameters = field(default_factory=ImuParameters)
    dvl: DvlParameters = field(default_factory=DvlParameters)
    gate: GateParameters = field(default_factory=GateParameters)
    process_noise: ProcessNoiseParameters = field(default_factory=ProcessNoiseParameters)
    initial: InitialParameters = field(default_factory=InitialParameters)
    origin: OriginParameters = field(default_factory=OriginParameters)

    def __post_init__(self) -> None:
        if self.output_delay > self.max_delay:
            raise ParameterError(
                f"parameter 'output_delay' must be at most max_delay ({self.max_delay:g} s), "
                f"got {self.output_delay!r}"
            )
        for name, value in (("max_delay", self.max_delay), ("imu.max_gap", self.imu.max_gap)):
            if self.jump_limit < value:
                raise ParameterError(
                    f"parameter 'jump_limit' must be at least {name} ({value:g} s), "
                    f"got {self.jump_limit!r}"
                )
        if self.state_file and self.state_period > self.jump_limit:
            raise ParameterError(
                f"parameter 'state_period' must be at most jump_limit ({self.jump_limit:g} s) "
                f"where there is a state_file, got {self.state_period!r}: before it "
                "is written again the state would be too old to go on from"
            )
        interval = 1.0 / self.imu.rate
        if self.imu.max_gap <= interval:
            raise ParameterError(
                f"parameter 'imu.max_gap' must be longer than the interval of imu.rate "
                f"({interval:g} s), got {self.imu.max_gap!r}: every sample would end a gap"
            )
        if 0.0 < self.imu.acceleration_range <= _GRAVITY:
            raise ParameterError(
                f"parameter 'imu.acceleration_range' must be 0 or more than gravity ({_GRAVITY} "
                f"m/s^2), got {self.imu.acceleration_range!r}: it would be saturated at rest"
            )
        _check_frames(self.odom_frame, self.base_frame)
        self._check_limits()

    def _check_limits(self) -> None:
        """A Q that is told is within the limits; the nominal one, without it, must be as well."""
        noise = self.process_noise
        if noise.source not in ("external", "message"):
            return
        for sensor in ("accelerometer", "gyroscope"):
            floor, ceiling = (getattr(noise, f"{sensor}_{end}") for end in ("floor", "ceiling"))
            for variance in getattr(noise, f"{sensor}_variance"):
                if not floor <= variance <= ceiling:
                    raise ParameterError(
                        f"parameter 'process_noise.{sensor}_variance' must be within its floor and "
                        f"ceiling ({floor:g} to {ceiling:g}) where the source is "
                        f"'{noise.source}', got {variance!r}"
                    )


@dataclass(frozen=True)
class TunerParameters:
    """Parameters of the tuner, for the node and for `insdvl replay`."""

    enabled: bool = parameter(True, "Publish process_noise; ~/enable changes it at run time.")
    model: str = parameter(
        "default", "Name of a model that ships with insdvl, or the path of a model's file."
    )
    rate: float = parameter(
        1.0, "How often Q is learned, in the time of the stamps.", unit="Hz", above=0.0, high=100.0
    )
    difference_order: int = parameter(
        0,
        "No variance is told above that of differences of this order (with a margin), which leave "
        "out the vehicle's own fast motion; 0 for no bound.",
        low=0,
        high=20,
    )
    max_gap: float = parameter(
        0.1,
        "A window that spans a longer interval between stamps is not used.",
        unit="s",
        above=0.0,
    )


@dataclass(frozen=True)
class ReplayParameters:
    """Parameters of the replay, for the node and for `insdvl replay`.

    The topics are the names in the recording; an empty one, or one that is not in it, is not
    played.
    """

    bag: str = parameter("", "Folder or file of the rosbag2 recording; the node needs it.")
    rate_factor: float = parameter(
        0.0,
        "Speed against the stamps, with /clock for the consumers; 0 is real time without /clock.",
        low=0.0,
        high=1000.0,
    )
    min_subscribers: int = parameter(
        1, "The node begins when imu/data_raw has this many subscriptions.", low=0, high=1000
    )
    imu_topic: str = parameter("/imu/data_raw", "sensor_msgs/Imu, played on imu/data_raw.")
    dvl_topic: str = parameter("/dvl/velocity", "TwistStamped, played on dvl/velocity.")
    dvl_covariance_topic: str = parameter(
        "/dvl/velocity_cov", "TwistWithCovarianceStamped, played on dvl/velocity_cov."
    )
    process_noise_topic: str = parameter(
        "/process_noise", "sensor_msgs/Imu, played on process_noise."
    )
    ground_truth_topic: str = parameter(
        "/ground_truth/odometry", "nav_msgs/Odometry, played on ground_truth/odometry."
    )
    true_process_noise_topic: str = parameter(
        "/ground_truth/process_noise", "sensor_msgs/Imu, played on ground_truth/process_noise."
    )
    fix_topic: str = parameter("/gps/fix", "sensor_msgs/NavSatFix, played on gps/fix.")
    set_odometry_topic: str = parameter(
        "/set_odometry", "nav_msgs/Odometry, played on set_odometry."
    )


@dataclass(frozen=True)
class SimulatedNoiseParameters:
    """White noise of the simulated IMU."""

    profile: str = parameter(
        "varying",
        "How the variances of the IMU's noise change: not at all (constant; constant-tableI is "
        "0.01^2, 0.001^2); each channel stepwise within [0.001, 0.05] (varying) or [1e-5, 0.05] "
        "(wide); all together between two levels (on-off); as a file says.",
        choices=("constant", "constant-tableI", "varying", "wide", "on-off", "file"),
    )
    accelerometer_variance: tuple[float, ...] = parameter(
        (0.01, 0.01, 0.01),
        "Variance per sample of the profile 'constant', and of 'on-off' when off.",
        unit="(m/s^2)^2",
        low=0.0,
        length=3,
    )
    gyroscope_variance: tuple[float, ...] = parameter(
        (0.001, 0.001, 0.001),
        "Variance per sample of the profile 'constant', and of 'on-off' when off.",
        unit="(rad/s)^2",
        low=0.0,
        length=3,
    )
    on_factor: float = parameter(
        20.0,
        "The variances of 'on-off' when on, as a multiple of those when off.",
        low=0.0,
        high=1e9,
    )
    half_period: float = parameter(
        30.0, "Time between the switches of 'on-off'.", unit="s", low=0.1
    )
    file: str = parameter(
        "",
        "CSV file of the profile 'file': time from the start, then the variances of f_b x, y, z "
        "and w_ib_b x, y, z that hold from then on.",
    )

    def __post_init__(self) -> None:
        if (self.profile == "file") != bool(self.file):
            raise ParameterError(
                "parameter 'noise.file' must name a file if noise.profile is 'file', and only "
                f"then; got {shown(self.file)} with noise.profile {self.profile!r}"
            )


@dataclass(frozen=True)
class SimulatedImuParameters:
    """The simulated IMU but for its white noise."""

    rate: float = parameter(100.0, "Samples per second.", unit="Hz", low=1.0, high=10_000.0)
    accelerometer_bias_std: float = parameter(
        1e-3, "Turn-on bias of each axis, one sigma.", unit="m/s^2", low=0.0
    )
    gyroscope_bias_std: float = parameter(
        1e-5, "Turn-on bias of each axis, one sigma.", unit="rad/s", low=0.0
    )
    accelerometer_bias_walk: float = parameter(
        1e-9, "Density of the accelerometer bias walk.", unit="(m/s^2)^2/s", low=0.0
    )
    gyroscope_bias_walk: float = parameter(
        1e-13, "Density of the gyroscope bias walk.", unit="(rad/s)^2/s", low=0.0
    )


@dataclass(frozen=True)
class SimulatedDvlParameters:
    """The simulated DVL."""

    rate: float = parameter(1.0, "Pings per second.", unit="Hz", low=0.01, high=100.0)
    mount: tuple[float, ...] = _mount("DVL")
    lever_arm: tuple[float, ...] = _lever_arm("DVL")
    noise_std: tuple[float, ...] = parameter(
        (0.1, 0.1, 0.1),
        "White noise of each velocity component, one sigma.",
        unit="m/s",
        low=0.0,
        length=3,
    )
    bias_std: float = parameter(
        0.0, "Stationary sigma of a first-order Gauss-Markov error.", unit="m/s", low=0.0
    )
    bias_time_constant: float = parameter(
        10.0, "Correlation time of the first-order Gauss-Markov error.", unit="s", above=0.0
    )
    outages: tuple[float, ...] = parameter(
        (0.0, 0.0),
        "Times without pings, from the start of the mission: start, end, start, end and so on.",
        unit="s",
        low=0.0,
    )
    outlier_probability: float = parameter(
        0.0, "Probability that a ping is an outlier.", low=0.0, high=1.0
    )
    outlier_size: float = parameter(
        3.0, "Length of the vector that is added to an outlier.", unit="m/s", low=0.0
    )

    def __post_init__(self) -> None:
        ordered = all(a <= b for a, b in zip(self.outages, self.outages[1:], strict=False))
        if len(self.outages) % 2 or not ordered:
            raise ParameterError(
                "parameter 'dvl.outages' must be pairs of start and end in rising order, "
                f"got {list(self.outages)!r}"
            )


@dataclass(frozen=True)
class SimulatorParameters:
    """Parameters of the simulator."""

    frame_convention: str = parameter(
        "enu",
        "Axes of all topics and of all vectors in these parameters: east-north-up and "
        "forward-left-up (REP-103), or north-east-down and forward-right-down.",
        choices=("enu", "ned"),
    )
    odom_frame: str = parameter("odom", "frame_id of the true odometry.")
    base_frame: str = parameter("base_link", "Frame of the vehicle and of the IMU.")
    dvl_frame: str = parameter("dvl_link", "Frame of the DVL.")
    trajectory: str = parameter(
        "auv",
        "The motion.",
        choices=("straight", "circle", "lawn_mower", "spiral_dive", "auv", "static", "loop"),
    )
    duration: float = parameter(
        0.0, "Length of the mission; 0 is all of the trajectory.", unit="s", low=0.0
    )
    seed: int = parameter(1, "Seed of all that is random.", low=0)
    rate_factor: float = parameter(
        0.0,
        "Speed against real time, with /clock and stamps from start_stamp; 0 is real time without "
        "/clock and with stamps from the wall time.",
        low=0.0,
        high=1000.0,
    )
    start_stamp: float = parameter(
        0.0,
        "Stamp of the start of the mission; with 0 it is the wall time unless rate_factor is set.",
        unit="s",
        low=0.0,
        high=2e9,
    )
    min_subscribers: int = parameter(
        0, "The mission begins when imu/data_raw has this many subscriptions.", low=0, high=1000
    )
    exclusive_wait: float = parameter(
        0.0,
        "Look for another publisher of imu/data_raw for this long before the start, and refuse to "
        "run beside it; 0 does not look.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    publish_covariance: bool = parameter(
        False, "Put the true variances of each sample in imu/data_raw; zeros (unknown) if not."
    )
    earth_rate: bool = parameter(True, "Simulate the rotation of the Earth.")
    noise: SimulatedNoiseParameters = field(default_factory=SimulatedNoiseParameters)
    imu: SimulatedImuParameters = field(default_factory=SimulatedImuParameters)
    dvl: SimulatedDvlParameters = field(default_factory=SimulatedDvlParameters)

    def __post_init__(self) -> None:
        _check_frames(self.odom_frame, self.base_frame)


@dataclass(frozen=True)
class RelayParameters:
    """Parameters of the relay, a link that loses, delays, reorders and doubles messages."""

    topics: tuple[str, ...] = parameter(
        ("imu/data_raw", "dvl/velocity"),
        "What is sent on: topics that the filter takes, or the simulator's truth.",
    )
    prefix: str = parameter(
        "sent/", "Each topic is taken from this and its name, and sent on by its name alone."
    )
    loss: float = parameter(0.0, "Probability that a message is lost.", low=0.0, high=1.0)
    duplication: float = parameter(
        0.0, "Probability that a message that is not lost arrives twice.", low=0.0, high=1.0
    )
    delay: float = parameter(
        0.0, "Time that every message takes at least, of the wall.", unit="s", low=0.0, high=60.0
    )
    jitter: float = parameter(
        0.0,
        "Largest further delay; each copy of a message has one of its own, evenly distributed, so "
        "messages that are closer than that overtake each other.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    seed: int = parameter(
        1, "Of all that is random: it decides what becomes of a topic's n-th message.", low=0
    )

    def __post_init__(self) -> None:
        if not self.prefix:
            raise ParameterError(
                "parameter 'prefix' must not be empty: the relay would hear itself"
            )


#: Sections of a YAML file, and the group that each one builds.
SECTIONS: Mapping[str, type[Any]] = MappingProxyType(
    {
        "insdvl_filter": FilterParameters,
        "insdvl_tuner": TunerParameters,
        "insdvl_replay": ReplayParameters,
        "insdvl_simulator": SimulatorParameters,
        "insdvl_relay": RelayParameters,
    }
)

#: Nodes that have no section, but may be given names of rclpy.
_WITHOUT_PARAMETERS = ("insdvl_monitor",)

#: Names that rclpy gives to every node; they are no parameters of ours.
ROS_NAMES = ("qos_overrides", "use_sim_time", "start_type_description_service")


def is_ros_name(name: str) -> bool:
    """Whether a parameter belongs to rclpy and not to us."""
    return name.split(".")[0] in ROS_NAMES


def load_section(path: Path, node: str, group: type[_Group], *, required: bool = False) -> _Group:
    """A group from the sections of a ROS 2 parameter file that end in a node's name.

    Args:
        path: The file.
        node: Name of the node.
        group: Its parameters.
        required: Whether there must be such a section; otherwise all defaults hold without one.

    Raises:
        ParameterError: The file cannot be read or is no parameter file, the section is missing, or
            `build` refuses it.
    """
    try:
        document = yaml_files.load(path)
    except (OSError, yaml_files.YamlError) as error:
        raise ParameterError(f"cannot read the parameter file {path}: {error}") from error
    if not isinstance(document, dict):
        raise ParameterError(f"{path} is no ROS 2 parameter file: it has no sections")
    values: dict[str, Any] = {}
    names = {section: str(section).rsplit("/", 1)[-1] for section in document}
    if required and node not in names.values():
        raise ParameterError(
            f"{path} has no section '/**/{node}'; it has {beginning(', '.join(map(str, document)))}"
        )
    nodes = (*SECTIONS, *_WITHOUT_PARAMETERS)
    for name in names.values():
        # A node may have been renamed, to insdvl_filter_2 for one.
        if name.startswith("insdvl_") and not f"{name}_".startswith(tuple(f"{n}_" for n in nodes)):
            raise ParameterError(f"{path}: no node is named {shown(name)}: {', '.join(nodes)}")
    for section, body in document.items():
        if names[section] != node:
            continue
        given = body.get("ros__parameters") if isinstance(body, dict) else None
        if not isinstance(given, dict) or len(body) > 1:
            raise ParameterError(
                f"{path}: section {section!r} must have 'ros__parameters' and nothing else"
            )
        for name, value in _full_names(given):
            if name in values and values[name] != value:
                raise ParameterError(
                    f"{path}, section {section!r}: parameter '{name}' is {shown(value)} here, and "
                    f"{shown(values[name])} above"
                )
            values[name] = value
    try:
        return build(group, {n: v for n, v in values.items() if not is_ros_name(n)})
    except ParameterError as error:
        raise ParameterError(f"{path}, section {node}: {error}") from error


def _full_names(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _full_names(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
