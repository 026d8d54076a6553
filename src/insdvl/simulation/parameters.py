"""Parameters of the simulator."""

from dataclasses import dataclass, field

from insdvl.parameters.declaration import check_frames, parameter
from insdvl.simulation.depth import DepthModel
from insdvl.simulation.dvl import DvlModel
from insdvl.simulation.heading import HeadingModel
from insdvl.simulation.imu import ImuModel
from insdvl.simulation.noise import NoiseParameters
from insdvl.simulation.trajectories import NAMES


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
        False, "Put the true variances of each sample in imu/data_raw; otherwise zeros (unknown)."
    )
    earth_rate: bool = parameter(True, "Simulate the rotation of the Earth.")
    noise: NoiseParameters = field(default_factory=NoiseParameters)
    imu: ImuModel = field(default_factory=ImuModel)
    dvl: DvlModel = field(default_factory=DvlModel)
    depth: DepthModel = field(default_factory=DepthModel)
    heading: HeadingModel = field(default_factory=HeadingModel)

    def __post_init__(self) -> None:
        check_frames(self.odom_frame, self.base_frame)
