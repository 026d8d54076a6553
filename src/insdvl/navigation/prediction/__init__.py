"""A state record advances with samples of the IMU."""
