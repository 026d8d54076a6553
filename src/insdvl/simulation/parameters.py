"""Parameters of the simulator."""

from dataclasses import dataclass, field

from insdvl.files import shown
from insdvl.parameters.declaration import ParameterError, check_frames, lever_arm, mount, parameter


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
    mount: tuple[float, ...] = mount("DVL")
    lever_arm: tuple[float, ...] = lever_arm("DVL")
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
        check_frames(self.odom_frame, self.base_frame)
