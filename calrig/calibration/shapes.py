"""Structure that no catalogue entry explains, against any covariate: smooth, kink, step, cycle in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effects.shape import Shape, tilted, turned, turns
from calrig.calibration.responses import MOVE, Responses
from calrig.estimation.angles import FloatArray

UNNAMED = "unnamed"
KNOTS = (3, 5)
PLACES = np.linspace(0.06, 0.94, 23)
FEWEST_VALUES = 8
MOST_CYCLES = 60.0
"""A run is searched for cycles in time up to this many, or as many as its poses can show."""


def unnamed_shapes(r: Responses) -> Iterator[tuple[str, Shape]]:
    """Every covariate's flexible shapes, as (covariate, shape)."""
    if turns(r):
        for shape in _of_one(r, r.theta_deg, "target_deg", stage=False):
            yield "target_deg", shape
        if MOVE in r.channels:  # without a gyro to feel it, a stage's shape is the same thing again
            for shape in _of_one(r, r.theta_deg, "target_deg", stage=True):
                yield "target_deg", shape
    if r.temperature_c is not None and np.ptp(r.temperature_c) > 0.0:
        for shape in _of_one(r, r.temperature_c, "temperature_c", stage=False):
            yield "temperature_c", shape
    for name, column in r.covariates.items():
        centred = (column - column.mean()) / column.std()
        yield name, Shape(tilted(centred), ("size_deg",), form="linear")
        for shape in _of_one(r, column, name, stage=False):
            yield name, shape
    if r.time_s is not None and np.ptp(r.time_s) > 0.0:
        for count in KNOTS:
            yield (
                "time_s",
                Shape(tilted(natural_spline(r.time_s, count)), ("size_deg",), form=f"smooth {count}"),
            )
        for shape in _cycles(r, r.time_s):
            yield "time_s", shape


def _of_one(r: Responses, z: FloatArray, name: str, *, stage: bool) -> Iterator[Shape]:
    values = len(np.unique(z))
    seen_by = (lambda f: turned(r, f)) if stage else tilted
    suffix = ", of the stage" if stage else ""
    for count in KNOTS:
        if values > count + 1:
            yield Shape(seen_by(natural_spline(z, count)), ("size_deg",), form=f"smooth {count}{suffix}")
    if values < FEWEST_VALUES:
        return
    for place in np.unique(np.quantile(z, PLACES)):
        at = {name: float(place)}
        yield Shape(
            seen_by(np.maximum(z - place, 0.0) / np.ptp(z)), ("size_deg",), form=f"kink{suffix}", at=at
        )
        yield Shape(seen_by((z >= place).astype(float)), ("size_deg",), form=f"step{suffix}", at=at)


def _cycles(r: Responses, time_s: FloatArray) -> Iterator[Shape]:
    span = float(np.ptp(time_s))
    most = min(0.45 * len(r), MOST_CYCLES)
    for frequency in np.arange(1.0 / span, most / span, 1.0 / (3.0 * span)):
        phase = 2.0 * np.pi * frequency * time_s
        waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        at = {"period": float(1.0 / frequency)}
        yield Shape(tilted(waves), ("size_deg",), form="cycle", at=at)


def natural_spline(z: FloatArray, count: int) -> FloatArray:
    """(n, ≤ count) basis of the natural cubic splines with knots at quantiles, the constant left out.

    Hastie, Tibshirani & Friedman, The Elements of Statistical Learning, equations 5.4 and 5.5.
    """
    u = (z - z.min()) / np.ptp(z)
    knots = np.unique(np.quantile(u, np.linspace(0.0, 1.0, count + 1)))
    if len(knots) < 3:
        return np.asarray(u[:, None], dtype=np.float64)
    last = knots[-1]

    def bend(k: int) -> FloatArray:
        cubes = np.maximum(u - knots[k], 0.0) ** 3 - np.maximum(u - last, 0.0) ** 3
        return np.asarray(cubes / (last - knots[k]), dtype=np.float64)

    straightened = [bend(k) - bend(len(knots) - 2) for k in range(len(knots) - 2)]
    return np.asarray(np.column_stack([u, *straightened]), dtype=np.float64)
