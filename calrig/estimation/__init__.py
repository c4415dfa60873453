"""Samples → reading: the Kalman filter, what a dwell's mean is worth, what the gyro says. Pure."""
