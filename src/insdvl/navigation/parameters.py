"""Parameters of the filter."""

import math
import re
from dataclasses import dataclass, field

from insdvl.files import shown
from insdvl.parameters.declaration import ParameterError, check_frames, lever_arm, mount, parameter


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
    mount: tuple[float, ...] = mount("IMU")
    lever_arm: tuple[float, ...] = lever_arm("IMU")
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
    mount: tuple[float, ...] = mount("DVL")
    lever_arm: tuple[float, ...] = lever_arm("DVL")
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
        check_frames(self.odom_frame, self.base_frame)
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
