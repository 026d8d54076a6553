"""Parameters of the filter: each group stands beside its user, here they come together."""

import dataclasses
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from insdvl.navigation.channels import ImuParameters
from insdvl.navigation.gate.parameters import GateParameters
from insdvl.navigation.geometry.earth import MAX_LATITUDE_DEG
from insdvl.navigation.geometry.frames import CONVENTIONS
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN, place_of
from insdvl.navigation.measurements.base import SensorParameters
from insdvl.navigation.measurements.depth import DepthParameters
from insdvl.navigation.measurements.dvl import DvlParameters
from insdvl.navigation.measurements.heading import HeadingParameters
from insdvl.navigation.process_noise.parameters import ProcessNoiseParameters
from insdvl.navigation.start.parameters import InitialParameters, OriginParameters
from insdvl.parameters.declaration import (
    ParameterError,
    check_all,
    check_frames,
    parameter,
)

_GRAVITY = 9.9  # m/s^2, more than anywhere on the Earth


@dataclass(frozen=True)
class FilterParameters:
    """Parameters of the filter, for the node and for `insdvl replay`."""

    frame_convention: str = parameter(
        "enu",
        "Axes of all topics and of all vectors in these parameters: east-north-up and "
        "forward-left-up (REP-103), or north-east-down and forward-right-down.",
        choices=("enu", "ned"),
    )
    map_frame: str = parameter(
        "map",
        "frame_id of odometry/global, published where an input tells heading or position.",
    )
    odom_frame: str = parameter("odom", "frame_id of odometry/filtered.")
    base_frame: str = parameter("base_link", "child_frame_id of the output.")
    publish_tf: bool = parameter(
        False,
        "Publish odom -> base_link on /tf and, where there is a map, map -> odom; needs tf2_msgs.",
    )
    extrinsics: str = parameter(
        "parameters",
        "Mounts and lever arms of IMU, DVL and other sensors: as these parameters say, or from "
        "/tf_static by the frame_id of the sensor's messages, or by its frame_id parameter.",
        choices=("parameters", "tf"),
    )
    error_state: str = parameter(
        "invariant", "Coordinates of the velocity error.", choices=("invariant", "ned")
    )
    earth_rate: bool = parameter(True, "Model the rotation of the Earth.")
    max_delay: float = parameter(
        2.0,
        "A message that is older than the newest IMU stamp by more than this is counted and "
        "dropped.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    output_delay: float = parameter(
        0.0,
        "Odometry is published this long after its stamp and includes all messages received by "
        "then.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    jump_limit: float = parameter(
        30.0,
        "An IMU stamp that is ahead of the newest by more than this, or older than max_delay, "
        "belongs to another time; ten such samples in a row are a time jump. Measurements and Q "
        "may be ahead by as much, or by the duration of 10,000 samples if that is longer.",
        unit="s",
        low=1.0,
        high=3600.0,
    )
    jump_action: str = parameter(
        "reset",
        "At a time jump, restart in the new time (reset), or refuse everything until stamps of the "
        "old time return or ~/reset is called (hold).",
        choices=("reset", "hold"),
    )
    q_timeout: float = parameter(
        5.0,
        "A received Q that is older than this, in the time of the stamps, is replaced by the "
        "nominal one, a received R by the filter's own.",
        unit="s",
        above=0.0,
    )
    state_file: str = parameter(
        "",
        "File in which the node keeps its state. After a restart it resumes from there if the "
        "first IMU stamp is at most jump_limit later. Empty for none; every filter needs a file "
        "of its own.",
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
    depth: DepthParameters = field(default_factory=DepthParameters)
    heading: HeadingParameters = field(default_factory=HeadingParameters)
    gate: GateParameters = field(default_factory=GateParameters)
    process_noise: ProcessNoiseParameters = field(default_factory=ProcessNoiseParameters)
    initial: InitialParameters = field(default_factory=InitialParameters)
    origin: OriginParameters = field(default_factory=OriginParameters)

    def __post_init__(self) -> None:
        check_all(
            self._check_output_delay,
            self._check_jump_limit,
            self._check_state_period,
            self._check_time_offsets,
            self._check_imu,
            self._check_earth_rate,
            partial(check_frames, self.odom_frame, self.base_frame),
            self._check_start,
            self._check_limits,
        )

    def _check_output_delay(self) -> None:
        if self.output_delay > self.max_delay:
            raise ParameterError(
                f"parameter 'output_delay' must be at most max_delay ({self.max_delay:g} s), "
                f"got {self.output_delay!r}"
            )

    def _check_jump_limit(self) -> None:
        for name, value in (("max_delay", self.max_delay), ("imu.max_gap", self.imu.max_gap)):
            if self.jump_limit < value:
                raise ParameterError(
                    f"parameter 'jump_limit' must be at least {name} ({value:g} s), "
                    f"got {self.jump_limit!r}"
                )

    def _check_state_period(self) -> None:
        if self.state_file and self.state_period > self.jump_limit:
            raise ParameterError(
                f"parameter 'state_period' must be at most jump_limit ({self.jump_limit:g} s) "
                f"where there is a state_file, got {self.state_period!r}: before it "
                "is written again the state would be too old to go on from"
            )

    def _check_time_offsets(self) -> None:
        earliest = self.imu.time_offset - self.max_delay
        for sensor in SENSORS:
            if (offset := getattr(self, sensor).time_offset) < earliest:
                raise ParameterError(
                    f"parameter '{sensor}.time_offset' must be at least imu.time_offset - "
                    f"max_delay ({earliest:g} s), got {offset!r}: every measurement would be too "
                    "late"
                )

    def _check_imu(self) -> None:
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

    def _check_earth_rate(self) -> None:
        asked = {"mode": "gyrocompassing", "heading": "gyrocompass"}
        for name, value in asked.items():
            if getattr(self.initial, name) == value and not self.earth_rate:
                raise ParameterError(
                    f"parameter 'initial.{name}' must not be '{value}' where earth_rate is false: "
                    "it finds the heading from the rotation of the Earth"
                )

    def _check_start(self) -> None:
        """The start must be a place at which the filter navigates, where the parameters tell it."""
        initial = self.initial
        if self.origin.source != "parameters" or initial.mode in ("topic", "set_odometry"):
            return
        p_o = CONVENTIONS[self.frame_convention].nav @ np.array(initial.position)
        if place_of(p_o, self.origin.place) is None:
            raise ParameterError(
                f"parameter 'initial.position' must be within {MAX_FROM_ORIGIN / 1e3:g} km of the "
                f"origin and {MAX_LATITUDE_DEG:g} deg of latitude, got {initial.position!r}"
            )

    def _check_limits(self) -> None:
        """Where Q is limited to floor and ceiling, the nominal one must be within them too."""
        noise = self.process_noise
        if noise.source not in ("external", "message") and not noise.adaptive_factor:
            return
        where = "with adaptive_factor" if noise.adaptive_factor else f"with source '{noise.source}'"
        for sensor in ("accelerometer", "gyroscope"):
            floor, ceiling = (getattr(noise, f"{sensor}_{end}") for end in ("floor", "ceiling"))
            for variance in getattr(noise, f"{sensor}_variance"):
                if not floor <= variance <= ceiling:
                    raise ParameterError(
                        f"parameter 'process_noise.{sensor}_variance' must be within its floor and "
                        f"ceiling ({floor:g} to {ceiling:g}) {where}, got {variance!r}"
                    )

    @property
    def sensors(self) -> dict[str, SensorParameters]:
        """Groups of the sensors, by the names of their measurements."""
        return {name: getattr(self, name) for name in SENSORS}


def _sensors() -> Mapping[str, type[SensorParameters]]:
    types = typing.get_type_hints(FilterParameters)
    return {
        item.name: types[item.name]
        for item in dataclasses.fields(FilterParameters)
        if isinstance(types[item.name], type) and issubclass(types[item.name], SensorParameters)
    }


#: Class of each sensor's parameters, by the name of its measurement: the fields of
#: `FilterParameters` that are one.
SENSORS = _sensors()
