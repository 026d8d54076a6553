"""Simulator, replay and demo of the INS/DVL filter as ROS 2 nodes."""
