"""Parameters of the simulator."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from insdvl.files import shown
from insdvl.parameters.declaration import ParameterError, check_frames, parameter
from insdvl.simulation.drawn.scenarios import DRAWN, Scenario
from insdvl.simulation.noise import (
    ACCELEROMETER_VARIANCE,
    GYROSCOPE_VARIANCE,
    SCENARIO_TEXTS,
    SCENARIOS,
    ProfileFactory,
    constant,
    from_file,
    on_off,
)
from insdvl.simulation.sensors.depth import DepthModel
from insdvl.simulation.sensors.dvl import DvlModel
from insdvl.simulation.sensors.heading import HeadingModel
from insdvl.simulation.sensors.imu import ImuModel
from insdvl.simulation.trajectories import NAMES


@dataclass(frozen=True)
class NoiseParameters:
    """Noise of the simulated IMU, and of what else a scenario draws."""

    profile: str = parameter(
        "varying",
        "Variances of the IMU noise: those of a scenario ("
        + "; ".join(f"{name}: {text}" for name, text in SCENARIO_TEXTS.items())
        + "), where 'constant' takes its values from the parameters below; two levels in turn for "
        "all channels (on-off); or those in a file. Or a scenario with noise that is not white, "
        f"vibration and waves ({', '.join(DRAWN)}; docs/explanation/effective-noise.md has them).",
        choices=(*SCENARIOS, *DRAWN, "on-off", "file"),
    )
    accelerometer_variance: tuple[float, ...] = parameter(
        (ACCELEROMETER_VARIANCE,) * 3,
        "Variance per sample of the profile 'constant', and of 'on-off' when off.",
        unit="(m/s^2)^2",
        low=0.0,
        length=3,
    )
    gyroscope_variance: tuple[float, ...] = parameter(
        (GYROSCOPE_VARIANCE,) * 3,
        "Variance per sample of the profile 'constant', and of 'on-off' when off.",
        unit="(rad/s)^2",
        low=0.0,
        length=3,
    )
    on_factor: float = parameter(
        20.0,
        "Factor on the variances of 'on-off' when on.",
        low=0.0,
        high=1e9,
    )
    half_period: float = parameter(
        30.0, "Time between the switches of 'on-off'.", unit="s", low=0.1
    )
    file: str = parameter(
        "",
        "CSV file of the profile 'file': time from the start, then the variances of f_b x, y, z "
        "and w_ib_b x, y, z that apply from then on.",
    )

    def __post_init__(self) -> None:
        if (self.profile == "file") != bool(self.file):
            raise ParameterError(
                "parameter 'noise.file' must name a file if noise.profile is 'file', and only "
                f"then; got {shown(self.file)} with noise.profile {self.profile!r}"
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
    depth_frame: str = parameter("depth_link", "Frame of the depth sensor.")
    trajectory: str = parameter(
        "auv",
        "The motion.",
        choices=NAMES,
    )
    duration: float = parameter(
        0.0, "Length of the mission; 0 means the whole trajectory.", unit="s", low=0.0
    )
    seed: int = parameter(1, "Random seed.", low=0)
    rate_factor: float = parameter(
        0.0,
        "Speed relative to real time, with /clock and stamps from start_stamp; 0 means real time "
        "without /clock and with stamps from the wall clock.",
        low=0.0,
        high=1000.0,
    )
    start_stamp: float = parameter(
        0.0,
        "Stamp of the start of the mission; 0 means the wall time unless rate_factor is set.",
        unit="s",
        low=0.0,
        high=2e9,
    )
    min_subscribers: int = parameter(
        0, "The mission starts when imu/data_raw has this many subscribers.", low=0, high=1000
    )
    exclusive_wait: float = parameter(
        0.0,
        "Look for another publisher of imu/data_raw for this long before the start, and do not "
        "start if there is one; 0 disables the check.",
        unit="s",
        low=0.0,
        high=60.0,
    )
    publish_covariance: bool = parameter(
        False,
        "Put the true variances of each sample in imu/data_raw, effective ones where the noise is "
        "not white; otherwise zeros (unknown).",
    )
    earth_rate: bool = parameter(True, "Simulate the rotation of the Earth.")
    noise: NoiseParameters = field(default_factory=NoiseParameters)
    imu: ImuModel = field(default_factory=ImuModel)
    dvl: DvlModel = field(default_factory=DvlModel)
    depth: DepthModel = field(default_factory=DepthModel)
    heading: HeadingModel = field(default_factory=HeadingModel)

    def __post_init__(self) -> None:
        check_frames(self.odom_frame, self.base_frame)


def chosen_noise(parameters: NoiseParameters) -> ProfileFactory | Scenario:
    """The profile or the scenario that the parameters describe.

    Raises:
        ParameterError: The file cannot be used.
    """
    level = np.array([*parameters.accelerometer_variance, *parameters.gyroscope_variance])
    if parameters.profile == "constant":
        return constant(level)
    if parameters.profile == "on-off":
        return on_off(level, parameters.on_factor * level, parameters.half_period)
    if parameters.profile == "file":
        try:
            return from_file(Path(parameters.file))
        except ValueError as error:
            raise ParameterError(f"parameter 'noise.file': {error}") from None
    return SCENARIOS.get(parameters.profile) or DRAWN[parameters.profile]
