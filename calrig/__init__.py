"""calrig: calibrates IMU attitude sensors on a rotary stage and traces what is left of the error."""

__version__ = "0.1.0"
