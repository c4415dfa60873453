"""Terms that several effects share.

Angles in degrees, s and c sine and cosine of the elevation θ. The sensor's effects turn the gravity vector in
the sensor's frame, (0, s, c) at θ = atan2(a_y, a_z): an error δ of a_y and ε of a_z turns the angle by
δ·c − ε·s (rad) and lengthens the vector by δ·s + ε·c.
"""

import math
import re
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from calrig.calibration.regression.channels import ANGLE, MOVE, NORM, READING
from calrig.calibration.regression.effect import (
    Applied,
    Circumstances,
    Documents,
    Parameters,
    Shape,
    VectorError,
)
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

DEG = 180.0 / np.pi
MG = 1e-3
ONE_THING = 1e-3
"""Of the time's standard deviation, what bias and elevation leave of it where the two are one thing."""
LEAST_TURN_DEG, LEAST_SHOWN_DEG = 330.0, 180.0
"""Poses over such an arc, that stand in so much of a turn, go round: the orders of a turn come apart."""
THE_TURN = "the turn"
"""The series of a full turn's orders."""
SMALL_STEP = 1e-3
"""Of a parameter, in its own unit: what it changes is a straight line there."""
ON_VECTOR = (
    "atan2(a_y, a_z) − φ, one vector for all effects on a_y = sin φ and a_z = cos φ, φ = bias + scale·θ: "
)
PHASE_UNKNOWN_DEG = 180.0 / math.sqrt(3.0)
"""Standard deviation of an angle of which nothing is known."""
LEAST_TEMPERATURE_RANGE_C = 0.05
LEAST_RETURN = 0.25
"""Of the range of temperature: what tells a delay behind it from a curve of it."""
LARGEST_FLOAT = float(np.finfo(np.float32).max)
SMALLEST_FLOAT = float(np.finfo(np.float32).tiny)


def turned(r: Responses, f: FloatArray) -> dict[str, FloatArray]:
    """Return what turns the sensor itself: reading and accelerometer see f, the gyro its change."""
    return {READING: f, ANGLE: f, MOVE: r.steps(f)}


def tilted(f: FloatArray, sense: float = 1.0) -> dict[str, FloatArray]:
    """Return what changes the angle too slowly or too seldom for the gyro, or inside the accelerometer.

    With the `sense` of the readings it is in the sense of the elevation, and they may fall while that rises.
    """
    return {READING: sense * f, ANGLE: f}


def turns(r: Responses) -> bool:
    """Return whether the poses stand at more than one elevation."""
    return float(np.ptp(r.theta_deg)) > 1.0


def covered(angles_deg: FloatArray, period_deg: float = 360.0) -> float:
    """Return how much of a period angles (n,) cover: all of it but the widest gap between them."""
    around = np.sort(np.mod(angles_deg, period_deg))
    return period_deg - float(np.diff(around, append=around[0] + period_deg).max())


def goes_round(r: Responses) -> bool:
    """Return whether the poses cover a turn, so that its orders mean something."""
    return r.arc_deg >= LEAST_TURN_DEG and covered(r.theta_deg) >= LEAST_SHOWN_DEG


def less_line(r: Responses, columns: FloatArray) -> FloatArray:
    """Return columns (n, p), or one of (n,), less what bias and scale have of them."""
    line = np.column_stack([np.ones(len(r)), r.theta_deg])
    return np.asarray(columns - line @ np.linalg.lstsq(line, columns, rcond=None)[0])


def is_time_elevation(r: Responses) -> bool:
    """Return whether the poses were taken once along the range at an even pace: any curve may be a drift."""
    if r.time_s is None or np.ptp(r.time_s) == 0.0:
        return False
    return bool(less_line(r, r.time_s[:, None]).std() < ONE_THING * r.time_s.std())


def alike_a_drift(r: Responses) -> tuple[str, ...]:
    """Return the name of the drift that a curve of the elevation may be, if it may be one."""
    return ("time_drift",) if is_time_elevation(r) else ()


def where_axes_show(r: Responses) -> Iterator[Parameters]:
    """Offer an effect on the accelerometer's axes where an accelerometer was read, or over a full turn.

    Of less than a turn without one, it is a curve of the angle like any other.
    """
    if {ANGLE, NORM}.intersection(r.channels) or goes_round(r):
        yield {}


def said_of_two_signals(r: Responses, _shape: Shape) -> list[str]:
    """Of an effect in mg where no accelerometer was read: evidence that says what it is a share of."""
    if {ANGLE, NORM}.intersection(r.channels):
        return []
    return [
        "the angle is taken for that of two signals, the sine y and the cosine z: 1 mg is a thousandth of "
        "their amplitude"
    ]


def sin_cos(r: Responses) -> tuple[FloatArray, FloatArray]:
    """Return sine and cosine of θ."""
    theta = np.radians(r.theta_deg)
    return np.sin(theta), np.cos(theta)


def one_or_both(
    angle: FloatArray,
    norm: FloatArray,
    names: tuple[str, str],
    at: Parameters | None = None,
    at_elevation: Callable[[FloatArray], FloatArray] | None = None,
) -> Iterator[Shape]:
    """Both columns (n, 2) together, and each alone: what one of them explains needs no second."""
    at = at or {}
    yield Shape({**tilted(angle), NORM: norm}, names, form="both", at=at, at_elevation=at_elevation)
    for k, name in enumerate(names):
        shares = {**tilted(angle[:, k]), NORM: norm[:, k]}
        own = at_elevation and partial(_one_of, at_elevation, k)
        yield Shape(shares, (name,), form=name, part_of="both", at=at, at_elevation=own)


def _one_of(several: Callable[[FloatArray], FloatArray], k: int, theta_deg: FloatArray) -> FloatArray:
    return several(theta_deg)[:, k]


def vector_forms(
    r: Responses,
    on_vector_g: Callable[[Applied], VectorError],
    names: tuple[str, str],
    at: Parameters | None = None,
) -> Iterator[Shape]:
    """Both of two parameters of an effect on a_y and a_z, and each alone, linear about no effect.

    None at one elevation alone.
    """
    if not turns(r):
        return
    s, c = sin_cos(r)
    given = Circumstances.of(r)

    def per_unit(name: str, component: int) -> FloatArray:
        more, less = (
            on_vector_g(Applied("", {**(at or {}), name: step}, r.theta_deg, given))[component]
            for step in (SMALL_STEP, -SMALL_STEP)
        )
        return np.full(len(r), (more - less) / (2.0 * SMALL_STEP))

    y, z = (np.stack([per_unit(name, component) for name in names], 1) for component in (0, 1))
    s, c = s[:, None], c[:, None]
    yield from one_or_both((y * c - z * s) * DEG, y * s + z * c, names, at)


def wave_deg(p: Applied, turn: FloatArray) -> FloatArray:
    """amplitude·sin(360°·turn + phase)."""
    phase = 2.0 * np.pi * turn + np.radians(p.value("phase_deg"))
    return np.asarray(p.value("amplitude_deg") * np.sin(phase), dtype=np.float64)


def amplitude_and_phase(_shape: Shape, beta: FloatArray, covariance: FloatArray) -> Documents:
    """A·sin(x + φ) of b₀·sin x + b₁·cos x, with root mean square errors to second order.

    An error ε across the vector (b₀, b₁) lengthens it by ε²/2A, whatever its sign (GUM 5.1.2, note): of an
    eccentricity within ±60° the sine is much less well known than the cosine, and this most of the error.
    """
    amplitude = max(float(np.hypot(*beta)), SMALLEST_FLOAT)
    along = beta / amplitude
    turn = np.array([along, [-along[1], along[0]]])
    (radial, mixed), (_, across) = turn @ covariance @ turn.T / amplitude**2
    # the true one is shorter than what was found by what it was lengthened
    phase = math.sqrt((across + radial * across + mixed**2) / max(1.0 - across, SMALLEST_FLOAT))
    return {
        "amplitude_deg": {
            "value": float(np.hypot(*beta)),
            "std": amplitude * math.sqrt(radial + 0.75 * across**2),
        },
        "phase_deg": {
            "value": math.degrees(math.atan2(beta[1], beta[0])),
            "std": min(math.degrees(phase), PHASE_UNKNOWN_DEG),
        },
    }


def warmer_c(r: Responses, at: Parameters) -> tuple[FloatArray, float] | None:
    """Temperature less its reference, the poses' mean where none is given; None where it does not vary."""
    if r.temperature_c is None or np.ptp(r.temperature_c) < LEAST_TEMPERATURE_RANGE_C:
        return None
    reference_c = float(at.get("reference_c", r.temperature_c.mean()))
    return np.asarray(r.temperature_c - reference_c, dtype=np.float64), reference_c


def warm_vector_forms(
    r: Responses, at: Parameters, on_vector_g: Callable[[Applied], VectorError], names: tuple[str, str]
) -> Iterator[Shape]:
    """`vector_forms` of an effect that follows temperature."""
    found = warmer_c(r, at)
    if found is not None:
        yield from vector_forms(r, on_vector_g, names, {"reference_c": found[1]})


def one_leg(r: Responses) -> bool:
    """Return whether no run's temperature came back, by a share of its range, from where it had gone."""
    if r.temperature_c is None:
        return True
    runs = np.split(r.temperature_c, np.flatnonzero(r.starts))
    least_c = LEAST_RETURN * float(np.ptp(r.temperature_c))
    return not any(min(_rise(run), _rise(-run)) >= least_c for run in runs if len(run))


def said_of_one_leg(r: Responses, _shape: Shape) -> list[str]:
    """Of what temperature alone cannot tell: evidence of an effect."""
    if not one_leg(r):
        return []
    return ["the temperature went one way only: a delay, a curve of it and a drift in time look the same"]


def _rise(values: FloatArray) -> float:
    """Return the most that a series ever lies above what it was before."""
    return float((values - np.minimum.accumulate(values)).max(initial=0.0))


def within(**most: float) -> Callable[[Shape, FloatArray], bool]:
    """Return whether coefficients are no larger than the given ones, by the names of their parameters."""

    def possible(shape: Shape, beta: FloatArray) -> bool:
        return all(abs(b) <= most[name] for name, b in zip(shape.parameters, beta, strict=False))

    return possible


def c_literal(value: float) -> str:
    """Return a C `float` constant, in brackets where it is negative.

    Raises:
        ValueError: it is none that a `float` holds.
    """
    if not math.isfinite(value) or abs(value) > LARGEST_FLOAT:
        raise ValueError(f"{value} is not a number that a float holds")
    text = f"{value if abs(value) >= SMALLEST_FLOAT else 0.0:.9g}"
    text = text if re.search(r"[.e]", text) else f"{text}.0"
    return f"({text}f)" if text.startswith("-") else f"{text}f"


def c_warmer(p: Parameters) -> str:
    """Return the C expression of the temperature less its reference."""
    return f"(temperature_c - {c_literal(p['reference_c'])})"


def c_wave(p: Parameters, order: float) -> str:
    """Return the C expression of amplitude·sin(order·θ + phase)."""
    amplitude, phase = (p.get(name, 0.0) for name in ("amplitude_deg", "phase_deg"))
    radians = f"theta * {c_literal(math.radians(order))} + {c_literal(math.radians(phase))}"
    return f"{c_literal(amplitude)} * sinf({radians})"


def size_deg(shape: Shape, beta: FloatArray, covariance: FloatArray) -> dict[str, float | None]:
    """Return peak to peak of what a shape adds to the reading, over its poses, with its standard error."""
    columns = shape.shares[READING].reshape(-1, len(beta))
    fitted = columns @ beta
    swing = columns[int(np.argmax(fitted))] - columns[int(np.argmin(fitted))]
    variance = max(float(swing @ covariance @ swing), 0.0)
    return {"value": float(fitted.max() - fitted.min()), "std": math.sqrt(variance)}
