"""Messages of drivers of DVLs, such as their recordings hold, without the drivers' packages."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from insdvl.messages.drivers import (
    DAVE,
    DRIVERS,
    DVL_MSGS,
    MARINE_ACOUSTIC,
    NUCLEUS_BOTTOM,
    NUCLEUS_WATER,
    STONEFISH,
    Axes,
)
from insdvl.messages.make import set_stamp
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import ENU, NED, Convention
from insdvl.recordings.base import Raw, encode, new_message

_SEPARATOR = "=" * 80
_NUCLEUS = (
    "builtin_interfaces/Time system_timestamp",
    "bool posix_time",
    "uint32 timestamp",
    "uint32 microseconds",
    *(f"bool beam_{n}_{what}_valid" for what in ("velocity", "distance", "fom") for n in (1, 2, 3)),
    *(f"bool {axis}_{what}_valid" for what in ("velocity", "fom") for axis in "xyz"),
    "uint32 serial_number",
    *(f"float32 {name}" for name in ("sound_speed", "temperature", "pressure")),
    *(
        f"float32 {what}_beam_{n}"
        for what in ("velocity", "distance", "fom", "dt", "time_vel")
        for n in (1, 2, 3)
    ),
    *(f"float32 {what}_{axis}" for what in ("velocity", "fom") for axis in "xyz"),
    "float32 dt_xyz",
    "float32 time_vel_xyz",
)


def _text(fields: tuple[str, ...], **others: tuple[str, ...]) -> str:
    """A definition of its fields, and of the types that it is made of (``package__Name``)."""
    lines = [*fields]
    for name, of in others.items():
        lines += [_SEPARATOR, f"MSG: {name.replace('__', '/')}", *of]
    return "\n".join(lines) + "\n"


#: Fields of each type that is not ROS's own, as its package has them.
DEFINITIONS: Mapping[str, str] = MappingProxyType(
    {
        MARINE_ACOUSTIC: _text(
            (
                "std_msgs/Header header",
                "uint8 velocity_mode",
                "uint8 dvl_type",
                "geometry_msgs/Vector3 velocity",
                "float64[9] velocity_covar",
                *(f"float64 {name}" for name in ("altitude", "course_gnd", "speed_gnd")),
                "uint8 num_good_beams",
                "float32 sound_speed",
                "bool beam_ranges_valid",
                "bool beam_velocities_valid",
                "geometry_msgs/Vector3[4] beam_unit_vec",
                "float64[4] range",
                "float32[4] range_covar",
                "float32[4] beam_quality",
                "float32[4] beam_velocity",
                "float32[4] beam_velocity_covar",
            )
        ),
        DVL_MSGS: _text(
            (
                "std_msgs/Header header",
                "float64 time",
                "geometry_msgs/Vector3 velocity",
                "float64 fom",
                "float64[] covariance",
                "float64 altitude",
                "dvl_msgs/DVLBeam[] beams",
                "bool velocity_valid",
                "int64 status",
                "int64 time_of_validity",
                "int64 time_of_transmission",
                "string form",
            ),
            dvl_msgs__DVLBeam=(
                "int64 id",
                *(f"float64 {name}" for name in ("velocity", "distance", "rssi", "nsd")),
                "bool valid",
            ),
        ),
        STONEFISH: _text(
            (
                "std_msgs/Header header",
                "geometry_msgs/Vector3 velocity",
                "float64[9] velocity_covariance",
                "float64 altitude",
                "stonefish_ros2/DVLBeam[] beams",
            ),
            stonefish_ros2__DVLBeam=(
                *(f"float64 {name}" for name in ("range", "range_covariance")),
                *(f"float64 {name}" for name in ("velocity", "velocity_covariance")),
                "geometry_msgs/PoseStamped pose",
            ),
        ),
        DAVE: _text(
            (
                "std_msgs/Header header",
                "string type",
                "dave_interfaces/DVLTarget target",
                "geometry_msgs/TwistWithCovariance velocity",
                "dave_interfaces/DVLBeam[] beams",
            ),
            dave_interfaces__DVLTarget=("string type", "float64 range"),
            dave_interfaces__DVLBeam=(
                "int64 id",
                "string reference",
                "float64 range",
                "bool locked",
                "geometry_msgs/TwistWithCovariance velocity",
            ),
        ),
        NUCLEUS_BOTTOM: _text(_NUCLEUS),
        NUCLEUS_WATER: _text(_NUCLEUS),
    }
)
_BEAMS: Mapping[str, str] = MappingProxyType(
    {
        DVL_MSGS: "dvl_msgs/msg/DVLBeam",
        STONEFISH: "stonefish_ros2/msg/DVLBeam",
        DAVE: "dave_interfaces/msg/DVLBeam",
    }
)


@dataclass(frozen=True)
class Told:
    """What a driver tells beside the velocity, where its type has it.

    Attributes:
        valid: Whether it marks the velocity as valid.
        sigma: Of each component [m/s]; 0 where it tells none.
        altitude: [m]; below zero without a bottom.
        good_beams: How many of the beams have the bottom; None for all of them.
        beams: Whether it fills in the beams.
        water: Whether the velocity is that through the water.
        latency_ns: From validity to transmission, by the device's clock; None for no such times.
    """

    valid: bool = True
    sigma: float = 0.0
    altitude: float = 20.0
    good_beams: int | None = None
    beams: bool = True
    water: bool = False
    latency_ns: int | None = None


PLAIN = Told()


def dvl_message(
    kind: str,
    stamp_ns: int,
    v: ArrayLike,
    told: Told = PLAIN,
    *,
    frame_id: str = "dvl_link",
    convention: Convention = ENU,
) -> Any:
    """A message of a type of `DRIVERS`.

    Args:
        kind: The type.
        stamp_ns: Stamp; of a type without a header the device's clock [ns].
        v: (3,) velocity, forward-right-down [m/s].
        told: What else the driver tells.
        frame_id: Of the header.
        convention: Axes of ROS's own types.
    """
    driver = DRIVERS[kind]
    message = new_message(kind, definition=DEFINITIONS.get(kind, ""))
    if driver.header:
        set_stamp(message, stamp_ns)
        message.header.frame_id = frame_id
    else:
        message.posix_time = True
        message.timestamp, message.microseconds = divmod(stamp_ns // 1000, NS // 1000)
    axes = {Axes.STREAM: convention, Axes.FRD: NED, Axes.FLU: ENU}[driver.axes].body
    signs = np.diagonal(axes)  # a rotation would make nan of a number that is not finite
    _set_three(message, driver.velocity, signs * np.asarray(v, dtype=float))
    if driver.covariance:
        P = np.zeros((driver.rows, driver.rows))
        P[:3, :3] = told.sigma**2 * np.eye(3)
        if driver.minus_one_is_invalid and not told.valid:
            P[0, 0] = -1.0
        _set(message, driver.covariance, P.ravel())
    if driver.sigma:
        _set_three(message, driver.sigma, [told.sigma] * 3)
    if driver.valid:
        _set_three(message, driver.valid, [told.valid] * 3)
    if driver.altitude:
        _set(message, driver.altitude, told.altitude)
    if driver.times is not None and told.latency_ns is not None:
        sent_us = stamp_ns // 1000 + 7_000_000  # of another clock
        for name, time_us in zip(
            driver.times, (sent_us - told.latency_ns // 1000, sent_us), strict=True
        ):
            _set(message, name, time_us)
    if kind == MARINE_ACOUSTIC:
        message.velocity_mode = 2 if told.water else 1
    if kind == DAVE:
        message.target.type = f"DVL_TARGET_{'WATER_MASS' if told.water else 'BOTTOM'}"
    if told.beams:
        _fill_beams(message, kind, told)
    return message


def _fill_beams(message: Any, kind: str, told: Told) -> None:
    driver = DRIVERS[kind]
    count = 3 if not driver.header else 4
    good = count if told.good_beams is None else told.good_beams
    if kind == MARINE_ACOUSTIC:
        message.num_good_beams = good
        message.beam_ranges_valid = True  # as one driver always writes
        message.range = np.where(np.arange(4) < good, 22.0, -1.0)
    elif not driver.header:
        for n in (1, 2, 3):
            for name in (f"beam_{n}_velocity_valid", f"beam_{n}_distance_valid"):
                _set(message, name, n <= good)
            _set(message, f"distance_beam_{n}", 22.0 if n <= good else 0.0)
            _set(message, f"velocity_beam_{n}", 0.1 if n <= good else -32.768)
    elif kind in _BEAMS:
        for k in range(count):
            beam = new_message(_BEAMS[kind], of=kind, definition=DEFINITIONS[kind])
            beam_range = 22.0 if k < good else -1.0
            _set(beam, "distance" if kind == DVL_MSGS else "range", beam_range)
            if kind != STONEFISH:
                _set(beam, "valid" if kind == DVL_MSGS else "locked", k < good)
            message.beams.append(beam)


def dvl_raw(topic: str, time_ns: int, message: Any) -> Raw:
    """A message of a type of `DRIVERS` as a recording holds it."""
    return encode(topic, time_ns, message, DEFINITIONS.get(message.__msgtype__, ""))


def _set_three(message: Any, name: str, values: ArrayLike) -> None:
    """Set a Vector3, three fields, or one field to the first of three equal values."""
    three: list[Any] = np.asarray(values).tolist()
    if "{axis}" in name:
        for axis, value in zip("xyz", three, strict=True):
            _set(message, name.format(axis=axis), value)
        return
    *path, last = name.split(".")
    for part in path:
        message = getattr(message, part)
    field = getattr(message, last)
    if hasattr(field, "x"):
        field.x, field.y, field.z = three
    else:
        _set(message, last, three[0])


def _set(message: Any, name: str, value: Any) -> None:
    """Set a field that is there; a message of a recording would take any."""
    *path, last = name.split(".")
    for part in path:
        message = getattr(message, part)
    getattr(message, last)
    setattr(message, last, value)
