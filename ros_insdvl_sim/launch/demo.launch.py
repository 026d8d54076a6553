"""A simulated vehicle, its navigator, and the monitor's table.

    ros2 launch ros_insdvl_sim demo.launch.py scenario:=wide seed:=3

It ends with the mission. `make demo` is another thing: it compares two filters and counts messages.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The simulator, navigator.launch.py, and the monitor."""
    namespace = LaunchConfiguration("namespace")
    navigator = PathJoinSubstitution(
        [FindPackageShare("ros_insdvl"), "launch", "navigator.launch.py"]
    )
    simulator_parameters = {
        "duration": ParameterValue(LaunchConfiguration("duration"), value_type=float),
        "noise.profile": ParameterValue(LaunchConfiguration("scenario"), value_type=str),
        "rate_factor": ParameterValue(LaunchConfiguration("rate_factor"), value_type=float),
        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
        "min_subscribers": 1,  # the navigator's
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution(
                    [FindPackageShare("ros_insdvl_sim"), "config", "demo.yaml"]
                ),
                description="YAML file with the parameters of the navigator",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics"
            ),
            DeclareLaunchArgument(
                "scenario", default_value="varying", description="Noise of the simulated IMU"
            ),
            DeclareLaunchArgument("seed", default_value="1", description="Random seed"),
            DeclareLaunchArgument(
                "duration", default_value="0.0", description="Seconds of mission; 0 flies all of it"
            ),
            DeclareLaunchArgument(
                "rate_factor",
                default_value="1.0",
                description="Speed, with /clock; 0 is real time without",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(navigator),
                launch_arguments={
                    "config": LaunchConfiguration("config"),
                    "namespace": namespace,
                }.items(),
            ),
            Node(package="ros_insdvl", executable="monitor", namespace=namespace, output="screen"),
            Node(
                package="ros_insdvl_sim",
                executable="simulator",
                namespace=namespace,
                parameters=[simulator_parameters],
                output="screen",
                on_exit=Shutdown(reason="the mission is over"),
            ),
        ]
    )
