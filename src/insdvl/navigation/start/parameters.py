"""What the filter is told of its start, and of where odom's origin is on the Earth."""

import math
import re
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.files import shown
from insdvl.navigation.geometry.earth import MAX_LATITUDE_DEG
from insdvl.navigation.geometry.odom import MAX_FROM_ORIGIN
from insdvl.parameters.declaration import ParameterError, parameter

#: Least number of levellings in a gyrocompassing: they are compared, to see whether it moves.
_LEAST_BLOCKS = 10
#: A topic's name as ROS 2 takes it.
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
#: Topics of the filter that have another type or another meaning, and its own output.
_NO_INITIAL_TOPIC = (
    "imu/data_raw",
    "dvl/velocity",
    "dvl/velocity_cov",
    "process_noise",
    "ground_truth/process_noise",
    "measurement_noise",
    "ground_truth/measurement_noise",
    "gps/fix",
    "set_odometry",
    "odometry/filtered",
    "gps/filtered",
)


@dataclass(frozen=True)
class InitialParameters:
    """The state at the start and its uncertainty."""

    mode: str = parameter(
        "auto",
        "How the filter starts: with what the sensors tell and nothing assumed, tilt from the "
        "accelerometer, velocity from the DVL, heading as initial.heading says (auto); from these "
        "values at the first IMU stamp (parameters); from the first message on initial.topic "
        "(topic); with roll and pitch from the accelerometer at rest (levelling), and with the "
        "heading from the Earth's rotation where gyroscope and rest allow it (gyrocompassing); on "
        "set_odometry only. set_odometry is taken in every mode.",
        choices=("auto", "parameters", "topic", "levelling", "gyrocompassing", "set_odometry"),
    )
    heading: str = parameter(
        "auto",
        "Where the mode 'auto' takes the heading from: the first that tells it of imu and "
        "gyrocompass, else unknown (auto); the yaw of initial.rpy (parameters); the orientation in "
        "imu/data_raw (imu); the Earth's rotation, at rest on a stand (gyrocompass); nothing "
        "(unknown).",
        choices=("auto", "parameters", "imu", "gyrocompass", "unknown"),
    )
    topic: str = parameter("ground_truth/odometry", "Odometry topic for the mode 'topic'.")
    levelling_time: float = parameter(
        1.0, "Duration over which a levelling averages the specific force.", unit="s", above=0.0
    )
    gyrocompass_time: float = parameter(
        60.0,
        "Duration over which gyrocompassing averages specific force and angular rate; at least "
        "ten times levelling_time.",
        unit="s",
        above=0.0,
    )
    position: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "Position of base_link in odom.",
        unit="m",
        low=-MAX_FROM_ORIGIN,
        high=MAX_FROM_ORIGIN,
        length=3,
    )
    rpy: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "Roll, pitch, yaw of base_link in odom; 'levelling' uses the yaw only, 'gyrocompassing' "
        "that where it finds none, 'auto' that with initial.heading 'parameters'.",
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
        math.radians(1.0),
        "One sigma of the heading; the mode 'gyrocompassing' is used where its own is smaller.",
        unit="rad",
        low=0.0,
    )
    accelerometer_bias_std: float = parameter(
        0.049,
        "One sigma of each axis. The default is that of a MEMS, 5 mg.",
        unit="m/s^2",
        low=0.0,
    )
    gyroscope_bias_std: float = parameter(
        4.85e-4,
        "One sigma of each axis. The default is that of a MEMS, 100 deg/h.",
        unit="rad/s",
        low=0.0,
    )
    position_std: float = parameter(0.1, "One sigma of each axis.", unit="m", low=0.0)

    @property
    def takes_orientation(self) -> bool:
        """Whether the orientation in imu/data_raw may tell the heading."""
        return self.mode == "auto" and self.heading in ("auto", "imu")

    @property
    def may_gyrocompass(self) -> bool:
        """Whether the heading may come from the rotation of the Earth."""
        automatic = self.mode == "auto" and self.heading in ("auto", "gyrocompass")
        return automatic or self.mode == "gyrocompassing"

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
        if self.heading != "auto" and self.mode != "auto":
            raise ParameterError(
                "parameter 'initial.heading' must be 'auto' where initial.mode is not 'auto', got "
                f"'{self.heading}' with the mode '{self.mode}'"
            )
        least = _LEAST_BLOCKS * self.levelling_time
        if self.may_gyrocompass and self.gyrocompass_time < least:
            raise ParameterError(
                f"parameter 'initial.gyrocompass_time' must be at least {_LEAST_BLOCKS} times "
                f"initial.levelling_time ({least:g} s), got {self.gyrocompass_time!r}"
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
        32.0,
        "Geodetic latitude of the origin.",
        unit="deg",
        low=-MAX_LATITUDE_DEG,
        high=MAX_LATITUDE_DEG,
    )
    longitude_deg: float = parameter(
        34.0, "Longitude of the origin.", unit="deg", low=-180.0, high=360.0
    )
    height: float = parameter(
        0.0, "Height of the origin above the ellipsoid.", unit="m", low=-12_000.0, high=100_000.0
    )

    @property
    def place(self) -> Array:
        """(3,) latitude, longitude [rad] and height [m]."""
        return np.array(
            [math.radians(self.latitude_deg), math.radians(self.longitude_deg), self.height]
        )
