"""A simulated vehicle: truth as functions of time, and the readings of its sensors."""
