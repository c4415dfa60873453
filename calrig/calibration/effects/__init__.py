"""The catalogue of physical effects: what each adds to the reading and to every witness of it."""

from calrig.calibration.effects import process, sensor, stage
from calrig.calibration.effects.shape import CATALOGUE, Effect, Shape

__all__ = ["CATALOGUE", "Effect", "Shape", "process", "sensor", "stage"]
