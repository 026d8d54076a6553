"""Which topics of a recording are played as which of ours."""

from dataclasses import dataclass

from insdvl.parameters.declaration import parameter


@dataclass(frozen=True)
class ReplayParameters:
    """Parameters of the replay, for the node and for `insdvl replay`.

    The topics are names in the recording. A topic that is empty, or that the recording does not
    have, is not played.
    """

    bag: str = parameter("", "Folder or file of the rosbag2 recording; required by the node.")
    rate_factor: float = parameter(
        0.0,
        "Speed relative to the stamps, with /clock for subscribers; 0 is real time without /clock.",
        low=0.0,
        high=1000.0,
    )
    min_subscribers: int = parameter(
        1, "The node starts when imu/data_raw has this many subscribers.", low=0, high=1000
    )
    imu_topic: str = parameter("/imu/data_raw", "sensor_msgs/Imu, played on imu/data_raw.")
    dvl_topic: str = parameter(
        "/dvl/velocity", "DVL, of any type of dvl.type, played on dvl/velocity."
    )
    dvl_covariance_topic: str = parameter(
        "/dvl/velocity_cov", "TwistWithCovarianceStamped, played on dvl/velocity_cov."
    )
    process_noise_topic: str = parameter(
        "/process_noise", "sensor_msgs/Imu, played on process_noise."
    )
    measurement_noise_topic: str = parameter(
        "/measurement_noise", "TwistWithCovarianceStamped, played on measurement_noise."
    )
    ground_truth_topic: str = parameter(
        "/ground_truth/odometry", "nav_msgs/Odometry, played on ground_truth/odometry."
    )
    true_process_noise_topic: str = parameter(
        "/ground_truth/process_noise", "sensor_msgs/Imu, played on ground_truth/process_noise."
    )
    true_measurement_noise_topic: str = parameter(
        "/ground_truth/measurement_noise",
        "TwistWithCovarianceStamped, played on ground_truth/measurement_noise.",
    )
    fix_topic: str = parameter("/gps/fix", "sensor_msgs/NavSatFix, played on gps/fix.")
    set_odometry_topic: str = parameter(
        "/set_odometry", "nav_msgs/Odometry, played on set_odometry."
    )
    further_topics: tuple[str, ...] = parameter(
        ("",),
        "Further topics that are played under their own names: those that parameters of the filter "
        "name. An empty name is none.",
    )
