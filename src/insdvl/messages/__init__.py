"""ROS messages without ROS: which topics there are, and what their messages mean."""
