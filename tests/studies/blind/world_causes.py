"""Causes that the first board has not: orders of the turn, a late reading, columns that nobody knew."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .causes import Draw
from .layout import Timeline
from .physics import Cause


def turn_of(k: int) -> Callable[[float], Draw]:
    """The k-th order of the stage's turn, of an amplitude in degrees; the first is an eccentricity."""

    def of(size_deg: float) -> Draw:
        def draw(rng: np.random.Generator, when: Timeline) -> Cause:
            phase = rng.uniform(0.0, 2.0 * math.pi)
            return Cause(
                "stage_eccentricity" if k == 1 else "stage_periodic",
                "stage",
                "target_deg",
                turned=lambda t, theta, v: size_deg * np.sin(k * np.radians(theta) + phase),
                felt=True,
                period_deg=None if k == 1 else 360.0 / k,
            )

        return draw

    return of


def offset_of_y(size_mg: float) -> Draw:
    """An accelerometer's offset, of y and of z as it comes, of y at least as much: z hardly tilts."""

    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        turn = rng.uniform(-0.25, 0.25) * math.pi
        sense = float(rng.choice([-1.0, 1.0]))
        y, z = sense * size_mg * math.cos(turn), size_mg * math.sin(turn)
        return Cause(
            "accelerometer_offset",
            "sensor",
            "target_deg",
            {"imu": {"accel_bias_mg": [0.0, y, z]}},
            parameters={"y_mg": y, "z_mg": z},
        )

    return draw


def late(filter_s: float) -> Draw:
    """A filter before readings that are taken on the move."""
    return lambda rng, when: Cause("latency", "process", "velocity", filter_s=filter_s)


def _of_column(name: str, angle_deg: Callable[[np.ndarray], np.ndarray]) -> Draw:
    def draw(rng: np.random.Generator, when: Timeline) -> Cause:
        at_pose = angle_deg(when.columns[name])

        def turned(t: np.ndarray, theta: np.ndarray, v: np.ndarray) -> np.ndarray:
            return at_pose[np.maximum(np.searchsorted(when.arrival_s, t, side="right") - 1, 0)]

        return Cause("unnamed", "unknown", name, turned=turned)

    return draw


def circle_of(name: str) -> Callable[[float], Draw]:
    """A wave in a column of degrees: an axis out of plumb."""
    return lambda size_deg: _of_column(name, lambda column: size_deg * np.cos(np.radians(column - 98.0)))


def linear_in(name: str) -> Callable[[float], Draw]:
    """So much per unit of a column."""
    return lambda per_unit: _of_column(name, lambda column: per_unit * (column - column.mean()))


def step_in(name: str) -> Callable[[float], Draw]:
    """A valve that opens where a column passes its median."""
    return lambda size_deg: _of_column(name, lambda column: size_deg * (column > np.median(column)))
