"""Terms that several effects are made of.

Angles in degrees, s and c sine and cosine of the elevation θ. The equations of the sensor's effects follow
from turning the gravity vector in the sensor's frame, (0, s, c) at elevation θ = atan2(a_y, a_z): an error δ
of a_y and ε of a_z turns the angle by δ·c − ε·s (rad) and lengthens the vector by δ·s + ε·c.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np

from calrig.calibration.effect import Applied, Parameters, Shape
from calrig.calibration.responses import ANGLE, MOVE, NORM, READING, Responses
from calrig.estimation.angles import FloatArray

DEG = 180.0 / np.pi
MG = 1e-3
THE_TURN = "the turn"
"""The series of a full turn's orders."""
LEAST_TEMPERATURE_RANGE_C = 0.05
LARGEST_FLOAT = float(np.finfo(np.float32).max)
SMALLEST_FLOAT = float(np.finfo(np.float32).tiny)


def turned(r: Responses, f: FloatArray) -> dict[str, FloatArray]:
    """What turns the sensor itself: reading and accelerometer see f, the gyro its change."""
    return {READING: f, ANGLE: f, MOVE: r.steps(f)}


def tilted(f: FloatArray) -> dict[str, FloatArray]:
    """What changes the angle too slowly or too seldom for the gyro, or inside the accelerometer."""
    return {READING: f, ANGLE: f}


def turns(r: Responses) -> bool:
    """Whether the poses stand at more than one elevation."""
    return float(np.ptp(r.theta_deg)) > 1.0


def sin_cos(r: Responses) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of θ."""
    theta = np.radians(r.theta_deg)
    return np.sin(theta), np.cos(theta)


def one_or_both(
    angle: FloatArray, norm: FloatArray, names: tuple[str, str], at: Parameters | None = None
) -> Iterator[Shape]:
    """Both columns (n, 2) together, and each alone: what one of them explains needs no second."""
    at = at or {}
    yield Shape({**tilted(angle), NORM: norm}, names, form="both", at=at)
    for k, name in enumerate(names):
        yield Shape({**tilted(angle[:, k]), NORM: norm[:, k]}, (name,), form=name, part_of="both", at=at)


def wave_deg(p: Applied, turn: FloatArray) -> FloatArray:
    """amplitude·sin(360°·turn + phase)."""
    phase = 2.0 * np.pi * turn + np.radians(p.value("phase_deg"))
    return np.asarray(p.value("amplitude_deg") * np.sin(phase), dtype=np.float64)


def warmer_c(r: Responses, at: Parameters) -> tuple[FloatArray, float] | None:
    """Temperature less its reference, the poses' mean where none is given; None where it does not vary."""
    if r.temperature_c is None or np.ptp(r.temperature_c) < LEAST_TEMPERATURE_RANGE_C:
        return None
    reference_c = float(at.get("reference_c", r.temperature_c.mean()))
    return np.asarray(r.temperature_c - reference_c, dtype=np.float64), reference_c


def c_literal(value: float) -> str:
    """A C `float` constant, in brackets where it is negative.

    Raises:
        ValueError: it is none that a `float` holds.
    """
    if not math.isfinite(value) or abs(value) > LARGEST_FLOAT:
        raise ValueError(f"{value} is not a number that a float holds")
    text = f"{value if abs(value) >= SMALLEST_FLOAT else 0.0:.9g}"
    text = text if re.search(r"[.e]", text) else f"{text}.0"
    return f"({text}f)" if text.startswith("-") else f"{text}f"


def c_turn(across: str, along: str) -> str:
    """The C expression of `Applied.turn_deg`."""
    return f"57.29577951f * atan2f({across}, 1.0f + {along})"


def c_warmer(p: Parameters) -> str:
    """The C expression of the temperature less its reference."""
    return f"(temperature_c - {c_literal(p['reference_c'])})"


def size_deg(shape: Shape, beta: FloatArray, covariance: FloatArray) -> dict[str, float | None]:
    """Peak to peak of what a shape adds to the reading, over its poses, with its standard error."""
    columns = shape.shares[READING].reshape(-1, len(beta))
    fitted = columns @ beta
    swing = columns[int(np.argmax(fitted))] - columns[int(np.argmin(fitted))]
    variance = max(float(swing @ covariance @ swing), 0.0)
    return {"value": float(fitted.max() - fitted.min()), "std": math.sqrt(variance)}
