"""The causes of the tuner."""
