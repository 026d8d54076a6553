"""Which measurements are used: what may be trusted, the filter, its IMU or the sensor?"""
