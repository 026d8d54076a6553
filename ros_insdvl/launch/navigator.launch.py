"""Filter and tuner aboard a vehicle.

    ros2 launch ros_insdvl navigator.launch.py config:=vehicle.yaml imu_topic:=/imu/data

`ros2 launch ros_insdvl navigator.launch.py --show-args` lists all arguments.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The nodes insdvl_filter and insdvl_tuner, in one process or in two."""
    defaults = PathJoinSubstitution([FindPackageShare("ros_insdvl"), "config", "navigator.yaml"])
    one_process = LaunchConfiguration("one_process")
    use_sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    common = {
        "package": "ros_insdvl",
        # A node has its own name: two nodes are in one process.
        "namespace": LaunchConfiguration("namespace"),
        # Later ones take precedence.
        "parameters": [defaults, LaunchConfiguration("config"), {"use_sim_time": use_sim_time}],
        "remappings": [
            ("imu/data_raw", LaunchConfiguration("imu_topic")),
            ("dvl/velocity", LaunchConfiguration("dvl_topic")),
        ],
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
        "output": "screen",
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=defaults,
                description="YAML file with the parameters of insdvl_filter and insdvl_tuner",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics"
            ),
            DeclareLaunchArgument(
                "imu_topic", default_value="imu/data_raw", description="Topic of the IMU"
            ),
            DeclareLaunchArgument(
                "dvl_topic", default_value="dvl/velocity", description="Topic of the DVL"
            ),
            DeclareLaunchArgument(
                "one_process",
                default_value="true",
                choices=["true", "false"],
                description="Both nodes in the executable navigator, which decodes the IMU once",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false"],
                description="Take the nodes' clock from /clock; no result depends on it",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="Least level of what is logged",
            ),
            OpaqueFunction(function=_check_config),
            Node(executable="navigator", condition=IfCondition(one_process), **common),
            Node(executable="filter", condition=UnlessCondition(one_process), **common),
            Node(executable="tuner", condition=UnlessCondition(one_process), **common),
        ]
    )


def _check_config(context: LaunchContext) -> None:
    """Refuse a file that does not exist; launch would start the nodes with their defaults.

    Raises:
        RuntimeError: It does not exist.
    """
    config = LaunchConfiguration("config").perform(context)
    if not Path(config).is_file():
        raise RuntimeError(f"launch argument 'config' must be a file, got '{config}'")
