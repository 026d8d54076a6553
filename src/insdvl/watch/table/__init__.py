"""The monitor's table: from the numbers of filters to the lines of a terminal, free of ROS."""
