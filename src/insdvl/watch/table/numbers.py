"""What the table shows of a filter."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from insdvl.arrays import Array

#: Levels of a finding, as those of `diagnostic_msgs/DiagnosticStatus`.
OK, WARN, ERROR, STALE = range(4)
LEVELS: Mapping[int, str] = {OK: "ok", WARN: "WARN", ERROR: "ERROR", STALE: "STALE"}


class Finding(NamedTuple):
    """Something that is not right.

    Attributes:
        level: One of `LEVELS`.
        text: One sentence, with its cause.
    """

    level: int
    text: str


@dataclass(frozen=True)
class Pose:
    """State of a filter, with one sigma of each number.

    Attributes:
        stamp_s: Stamp [s].
        position: (3,) north, east and depth below the origin [m].
        rpy_deg: (3,) roll, pitch and heading [deg], heading from north over east, 0 to 360.
        velocity: (3,) in body axes, forward, right, down [m/s].
        position_sigma: (3,) [m].
        rpy_sigma_deg: (3,) [deg].
        velocity_sigma: (3,) [m/s].
    """

    stamp_s: float
    position: Array
    rpy_deg: Array
    velocity: Array
    position_sigma: Array
    rpy_sigma_deg: Array
    velocity_sigma: Array


@dataclass(frozen=True)
class Measured:
    """What became of the measurements of a sensor.

    Attributes:
        label: What an operator calls the sensor.
        used: Measurements that were used.
        refused: Those that were not, by reason.
        age: Time since the last one that was used [s]; None where it is not known.
    """

    label: str
    used: int
    refused: Mapping[str, int]
    age: float | None = None


@dataclass(frozen=True)
class Triads:
    """A number for each axis of accelerometer and gyroscope.

    Attributes:
        f: (3,) of the specific force [m/s^2].
        w: (3,) of the angular rate [rad/s].
    """

    f: Array
    w: Array


class VelocityError(NamedTuple):
    """Length of the error of the body velocity against the truth [m/s].

    Attributes:
        now: At the last stamp.
        rms: Over the window.
        three_sigma: What it should stay below.
    """

    now: float
    rms: float
    three_sigma: float


@dataclass(frozen=True)
class Shown:
    """A filter, with None for everything that is not known of it.

    Attributes:
        label: Its namespace.
        node: Its full name.
        silent: Wall time since it was last heard of [s].
        still: Wall time since its last odometry [s].
        pose: Its state.
        measured: Its measurements, the DVL first.
        nis: Mean normalised innovation squared of the DVL.
        nis_count: Over how many measurements.
        bias: Estimated biases.
        bias_sigma: Their sigmas.
        noise: Sigma per sample of the process noise in use.
        nominal: Of the nominal one.
        true_noise: Of the IMU, where a simulator tells it.
        noise_source: Where it comes from, and how old it is.
        inflations: How often the gate inflated the covariance.
        restarts: How often it restarted the state from a measurement.
        imu_rate: Of the IMU messages [Hz].
        output_rate: Of the odometry [Hz].
        error: Against the truth, where there is one.
        findings: What is not right, the worst first.
    """

    label: str
    node: str
    silent: float | None = None
    still: float | None = None
    pose: Pose | None = None
    measured: tuple[Measured, ...] = ()
    nis: float | None = None
    nis_count: int = 0
    bias: Triads | None = None
    bias_sigma: Triads | None = None
    noise: Triads | None = None
    nominal: Triads | None = None
    true_noise: Triads | None = None
    noise_source: str = ""
    inflations: int = 0
    restarts: int = 0
    imu_rate: float | None = None
    output_rate: float | None = None
    error: VelocityError | None = None
    findings: tuple[Finding, ...] = field(default=())
