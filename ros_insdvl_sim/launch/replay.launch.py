"""A recording, navigated again as it was received, and the monitor's table.

    ros2 launch ros_insdvl_sim replay.launch.py bag:=FOLDER config:=vehicle.yaml

It ends with the recording. `insdvl replay` does the same without ROS, faster, and with scores.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The replay node, navigator.launch.py, and the monitor."""
    config, namespace = LaunchConfiguration("config"), LaunchConfiguration("namespace")
    navigator = PathJoinSubstitution(
        [FindPackageShare("ros_insdvl"), "launch", "navigator.launch.py"]
    )
    replay_parameters = {
        "bag": ParameterValue(LaunchConfiguration("bag"), value_type=str),
        "rate_factor": ParameterValue(LaunchConfiguration("rate_factor"), value_type=float),
        "min_subscribers": 1,  # the navigator's
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="Folder or file of the rosbag2 recording"),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution(
                    [FindPackageShare("ros_insdvl_sim"), "config", "recording.yaml"]
                ),
                description="YAML file with the parameters of insdvl_filter, insdvl_tuner and "
                "insdvl_replay (the topics of the recording)",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics"
            ),
            DeclareLaunchArgument(
                "rate_factor",
                default_value="1.0",
                description="Speed, with /clock; 0 is real time without",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(navigator),
                launch_arguments={"config": config, "namespace": namespace}.items(),
            ),
            Node(package="ros_insdvl", executable="monitor", namespace=namespace, output="screen"),
            Node(
                package="ros_insdvl_sim",
                executable="replay",
                namespace=namespace,
                parameters=[config, replay_parameters],
                output="screen",
                on_exit=Shutdown(reason="the recording is over"),
            ),
        ]
    )
