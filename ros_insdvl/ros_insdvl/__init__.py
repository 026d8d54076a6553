"""The ROS 2 nodes of the INS/DVL filter: message -> dataclass -> core -> message."""
