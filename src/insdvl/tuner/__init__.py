"""Learned process noise: windows of IMU samples, their features, the models, the schedule."""
