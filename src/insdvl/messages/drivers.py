"""What drivers of DVLs publish: a table of message types, and the ping that each type tells.

A message becomes a `Ping` by the row of its type in `DRIVERS`, which names the fields of velocity,
covariance, validity and so on. No rule beyond the table knows a driver. Types are told apart by
their names, so messages of rclpy and of recordings are the same here, and no package of a driver is
imported. A field that a definition lacks says nothing: drivers have had several versions of them.
What becomes of a ping is in dvl.py.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import reduce
from math import nan
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from insdvl.arrays import Array
from insdvl.messages.convert import ODOMETRY, TWIST, TWIST_WITH_COVARIANCE


class Axes(Enum):
    """Axes of a type's velocity, in words; the instrument looks down."""

    STREAM = "those of `frame_convention`"
    FRD = "x forward, z along the beams (forward-right-down)"
    FLU = "x forward, z against the beams (forward-left-up)"


class Beam(NamedTuple):
    """A beam of a ping.

    Attributes:
        good: Whether it has the bottom; None where the type tells only how many have.
        range: Distance along the beam [m].
        velocity: Velocity along the beam [m/s]; 0 where the type does not have it as a number.
    """

    good: bool | None
    range: float
    velocity: float

    @property
    def filled(self) -> bool:
        """Whether the sender has filled it in: a message begins with zeros."""
        return bool(self.good) or self.range != 0.0 or self.velocity != 0.0


@dataclass(frozen=True)
class Ping:
    """A ping as its message tells it; nothing of it is checked yet.

    Attributes:
        velocity: (3,) in the axes of the type [m/s].
        measured: Which components are marked as valid.
        covariance: Of the velocity, row-major [(m/s)^2]; None where the type has none.
        sigma: (3,) figure of merit [m/s]; 0 where it is not told.
        altitude: Above the bottom [m], below zero for none; NaN where it is not told.
        good_beams: How many beams have the bottom; None where it is not told.
        beams: Those that are filled in.
        water: Whether the velocity is that through the water.
    """

    velocity: Array
    measured: tuple[bool, bool, bool]
    covariance: Sequence[float] | Array | None
    sigma: Array
    altitude: float
    good_beams: int | None
    beams: tuple[Beam, ...]
    water: bool


def _no_beams(message: Any) -> list[Beam]:
    return []


def _never(message: Any) -> bool:
    return False


def _always(message: Any) -> bool:
    return True


@dataclass(frozen=True)
class Driver:
    """Where a message type has what. Names are those of fields, nested ones with dots.

    A name with ``{axis}`` stands for three fields, those of x, y and z. An empty name means that
    the type does not have it.

    Attributes:
        publishers: Who publishes the type.
        package: How to get its package where it is not installed; empty for those of ROS itself.
        axes: Of the velocity.
        velocity: A Vector3, or three numbers.
        covariance: Row-major covariance of the velocity.
        rows: Number of its rows: 3, or 6 of a twist.
        packed: Whether a bridge writes a covariance of three rows to the beginning of six.
        sigma: Figure of merit, where its maker says that it is a standard deviation.
        valid: Flags of validity.
        minus_one_is_invalid: Whether a first variance of -1 marks the ping, and not the variance.
        altitude: Above the bottom.
        good_beams: Number of beams that have the bottom.
        beams: The beams of a message.
        beam_flags: Flags that say that beams are filled in. With them `valid` speaks of the beams,
            and says nothing where nothing of the beams is filled in.
        water: Whether a message is of the water.
        times: Time of validity and time of transmission by the device's clock [us].
        header: Whether there is a header; else there is a POSIX time.
    """

    publishers: str
    package: str = ""
    axes: Axes = Axes.STREAM
    velocity: str = "velocity"
    covariance: str = ""
    rows: int = 3
    packed: bool = False
    sigma: str = ""
    valid: str = ""
    minus_one_is_invalid: bool = False
    altitude: str = ""
    good_beams: str = ""
    beams: Callable[[Any], list[Beam]] = _no_beams
    beam_flags: tuple[str, ...] = ()
    water: Callable[[Any], bool] = _never
    times: tuple[str, str] | None = None
    header: bool = True

    @property
    def refusals(self) -> tuple[str, ...]:
        """Reasons for which a message of the type may be refused."""
        if self.water is _always:
            return "bad_stamp", "no_stamp", "no_data", "invalid", "through_water"
        reasons = ["bad_stamp", "no_stamp", "not_finite"]
        if self.covariance or self.sigma:
            reasons += ["no_data", "bad_covariance", "invalid"]
        if self.axes is not Axes.STREAM:
            reasons += ["no_data", "invalid"]
        if self.altitude or self.beams is not _no_beams:
            reasons.append("no_bottom")
        if self.water is not _never:
            reasons.append("through_water")
        return tuple(dict.fromkeys(reasons))


# ---------------------------------------------------------------- beams and references


def _listed(good: str, range_: str, velocity: str = "") -> Callable[[Any], list[Beam]]:
    """Beams that are messages of a list; without a flag one is good where its range is above 0."""

    def beam_of(message: Any) -> Beam:
        distance = _number(message, range_, 0.0)
        is_good = bool(field_of(message, good, False)) if good else distance > 0.0
        return Beam(is_good, distance, _number(message, velocity, 0.0))

    return lambda message: [beam_of(beam) for beam in field_of(message, "beams", ())]


def _arrays(message: Any) -> list[Beam]:
    """Beams of marine_acoustic_msgs, which are numbers of arrays."""
    ranges, velocities = (field_of(message, name, ()) for name in ("range", "beam_velocity"))
    return [Beam(None, float(r), float(v)) for r, v in zip(ranges, velocities, strict=False)]


def _numbered(message: Any) -> list[Beam]:
    """The three beams of a Nucleus, each with fields of its own."""
    return [
        Beam(
            bool(field_of(message, f"beam_{n}_velocity_valid", False)),
            _number(message, f"distance_beam_{n}", 0.0),
            _number(message, f"velocity_beam_{n}", 0.0),
        )
        for n in (1, 2, 3)
    ]


def _dave_water(message: Any) -> bool:
    return "WATER" in str(field_of(message, "target.type", ""))


# ---------------------------------------------------------------- the table

MARINE_ACOUSTIC = "marine_acoustic_msgs/msg/Dvl"
DVL_MSGS = "dvl_msgs/msg/DVL"
STONEFISH = "stonefish_ros2/msg/DVL"
DAVE = "dave_interfaces/msg/DVL"
NUCLEUS_BOTTOM = "interfaces/msg/BottomTrack"
NUCLEUS_WATER = "interfaces/msg/WaterTrack"

_NUCLEUS = Driver(
    publishers="NortekSupport/nucleus_driver",
    package="no Debian package has it: build `interfaces` of NortekSupport/nucleus_driver (ros2)",
    axes=Axes.FRD,
    velocity="velocity_{axis}",
    sigma="fom_{axis}",
    valid="{axis}_velocity_valid",
    beams=_numbered,
    header=False,
)

#: What each type tells, by the name of the type; ROS's own come first.
DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        TWIST: Driver(publishers="our simulator, many drivers", velocity="twist.linear"),
        TWIST_WITH_COVARIANCE: Driver(
            publishers="many drivers; HoloOcean's ROS package",
            velocity="twist.twist.linear",
            covariance="twist.covariance",
            rows=6,
        ),
        ODOMETRY: Driver(
            publishers="odometry of drivers, of which the twist is taken",
            velocity="twist.twist.linear",
            covariance="twist.covariance",
            rows=6,
        ),
        MARINE_ACOUSTIC: Driver(
            publishers="waterlinked/waterlinked_dvl, ndahn/dvl_a50, Gazebo by ros_gz_bridge",
            package="install the Debian package ros-jazzy-marine-acoustic-msgs",
            axes=Axes.FRD,
            covariance="velocity_covar",
            valid="beam_velocities_valid",
            altitude="altitude",
            good_beams="num_good_beams",
            beams=_arrays,
            beam_flags=("beam_ranges_valid", "beam_velocities_valid"),
            water=lambda message: int(field_of(message, "velocity_mode", 0)) == 2,
        ),
        DVL_MSGS: Driver(
            publishers="paagutie/dvl-a50, cougars-auv/holoocean_bridge",
            package="no Debian package has it: build paagutie/dvl_msgs",
            axes=Axes.FRD,
            covariance="covariance",
            sigma="fom",
            valid="velocity_valid",
            altitude="altitude",
            beams=_listed("valid", "distance", "velocity"),
            times=("time_of_validity", "time_of_transmission"),
        ),
        STONEFISH: Driver(
            publishers="patrykcieslak/stonefish_ros2",
            package="no Debian package has it: build patrykcieslak/stonefish_ros2",
            axes=Axes.FLU,
            covariance="velocity_covariance",
            minus_one_is_invalid=True,
            altitude="altitude",
            beams=_listed("", "range", "velocity"),
        ),
        DAVE: Driver(
            publishers="IOES-Lab/dave",
            package="no Debian package has it: build `dave_interfaces` of IOES-Lab/dave",
            axes=Axes.FLU,
            velocity="velocity.twist.linear",
            covariance="velocity.covariance",
            rows=6,
            packed=True,
            altitude="target.range",
            beams=_listed("locked", "range"),
            water=_dave_water,
        ),
        NUCLEUS_BOTTOM: _NUCLEUS,
        NUCLEUS_WATER: replace(_NUCLEUS, water=_always),
    }
)
#: The types, ROS's own first.
TYPES = tuple(DRIVERS)
#: Reasons for which a message of any of the types may be refused.
REFUSALS = tuple(dict.fromkeys(reason for driver in DRIVERS.values() for reason in driver.refusals))


def type_of(message: Any) -> str:
    """The type of a message, ``package/msg/Name``.

    A message without a type of its own is one of ROS's, which are told apart by their fields.
    """
    if (kind := _name_of_type(message)) in DRIVERS:
        return kind
    return TWIST_WITH_COVARIANCE if hasattr(message.twist, "covariance") else TWIST


def axes_of(message: Any) -> Axes:
    """Axes of the velocity of a message, by the name of its type."""
    driver = DRIVERS.get(_name_of_type(message))
    return Axes.STREAM if driver is None else driver.axes


def _name_of_type(message: Any) -> str:
    kind = getattr(message, "__msgtype__", None)  # of a recording
    if kind is None:
        kind = f"{type(message).__module__.partition('.')[0]}/msg/{type(message).__name__}"
    return str(kind)


# ---------------------------------------------------------------- messages to pings


def field_of(message: Any, name: str, default: Any) -> Any:
    """A field by its name, nested ones with dots; the default where the message lacks it."""
    try:
        return reduce(getattr, name.split("."), message)
    except AttributeError:
        return default


def _number(message: Any, name: str, default: float) -> float:
    return float(field_of(message, name, default))


def _three(message: Any, name: str, default: Any) -> list[Any]:
    """Three fields, or one field three times."""
    return [field_of(message, name.format(axis=axis), default) for axis in "xyz"]


def _unpacked(covariance: Sequence[float]) -> Array:
    """Covariance of a twist, also where its first nine numbers are those of the velocity alone."""
    flat = np.asarray(covariance, dtype=float)
    if flat.size != 36 or flat[9:].any() or not (flat[4] or flat[8]):
        return flat
    whole = np.zeros((6, 6))
    whole[:3, :3] = flat[:9].reshape(3, 3)
    return whole.ravel()


def ping(message: Any) -> Ping:
    """What a message of one of the `TYPES` tells."""
    driver = DRIVERS[type_of(message)]
    if "{axis}" in driver.velocity:
        velocity = _three(message, driver.velocity, nan)
    else:
        field = reduce(getattr, driver.velocity.split("."), message)
        velocity = [field.x, field.y, field.z]
    beams = tuple(beam for beam in driver.beams(message) if beam.filled)
    count = sum(bool(beam.good) for beam in beams)
    if driver.good_beams:
        count = int(field_of(message, driver.good_beams, 0))
    x, y, z = (bool(flag) for flag in _three(message, driver.valid, True))
    flagged = any(field_of(message, name, False) for name in driver.beam_flags)
    if driver.beam_flags and not (flagged or beams or count):
        x = y = z = True
    covariance: Any = field_of(message, driver.covariance, None) if driver.covariance else None
    if driver.packed and covariance is not None:
        covariance = _unpacked(covariance)
    if driver.rows == 3 and covariance is not None and not len(covariance):
        covariance = None  # a sequence that was left empty
    marked = driver.minus_one_is_invalid and covariance is not None
    if marked and list(covariance[:1]) == [-1.0]:
        x = y = z = False
    return Ping(
        velocity=np.array(velocity, dtype=float),
        measured=(x, y, z),
        covariance=covariance,
        sigma=np.array(_three(message, driver.sigma, 0.0) if driver.sigma else [0.0] * 3),
        altitude=_number(message, driver.altitude, nan) if driver.altitude else nan,
        good_beams=count if beams or count else None,
        beams=beams,
        water=driver.water(message),
    )
