"""The learned process noise: windows of IMU samples, their features, the model, the schedule."""
