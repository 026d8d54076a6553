"""Declaration of parameters, their checks, and parameter files of ROS 2."""
