"""Are DVL and IMU mounted, scaled and timed as the parameters say, and if not, what is wrong."""
