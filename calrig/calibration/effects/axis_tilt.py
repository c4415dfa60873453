"""A stage's axis out of level, and a unit that does not sit square to it.

Turned by a yaw ψ about z and a pitch φ about y against an axis that rises by β, the unit at elevation θ feels
(β + ψ·s − φ·c, s − β·ψ − ψ²·s/2, c + φ·(β + ψ·s) − φ²·c/2) to second order, s and c sine and cosine of θ.
With ψ = m·cos α and φ = m·sin α its elevation is off by (m²/4)·sin(2θ + phase), phase = 180° − 2α, and by
−β·m·cos(θ − α). a_x tells m and α. |a| of all three axes tells nothing, since nothing is wrong with the
sensor, nor does the gyro, which turns as it is turned: that parts this from gains and from the stage.
"""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import (
    ELEVATION,
    Applied,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import sin_cos, tilted, turns
from calrig.estimation.angles import FloatArray

SURE = 8.0
"""Standard errors of a_x's own swing, from where on its direction is worth taking over."""
CROSS_AXIS_DEG = 1.5
"""What a data sheet allows an axis to see of its neighbours (2–3 %): a_x may show as much more or less."""
STEEPEST_DEG = 15.0
"""Of an axis that is meant to be level."""
NAMES = ("amplitude_deg", "first_order_deg")


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    place = _place(r) if "phase_deg" not in at else {k: at[k] for k in ("phase_deg", "cross_deg") if k in at}
    if place is None or not turns(r):
        return
    both = np.stack(_waves(r.theta_deg, place["phase_deg"]), axis=1)
    yield Shape(tilted(both), NAMES, form="both", at=place)
    for k, name in enumerate(NAMES):
        yield Shape(tilted(both[:, k]), (name,), form=name, at=place, part_of="both")


def _waves(theta_deg: FloatArray, phase_deg: float) -> tuple[FloatArray, FloatArray]:
    """sin(2θ + phase), and −cos(θ − α)."""
    theta, phase = np.radians(theta_deg), np.radians(phase_deg)
    return np.sin(2.0 * theta + phase), -np.cos(theta - 0.5 * (np.pi - phase))


def _place(r: Responses) -> Parameters | None:
    """Return the phase and m by a_x, its bias aside; None where a_x is not there or does not tell them."""
    if r.across_g is None or not turns(r):
        return None
    s, c = sin_cos(r)
    columns = np.column_stack([np.ones(len(r)), s, -c])
    inverse = np.linalg.pinv(columns.T @ columns)
    beta = inverse @ columns.T @ r.across_g
    left = r.across_g - columns @ beta
    variance = float(left @ left) / max(len(r) - columns.shape[1], 1)
    swing, spread = float(np.hypot(*beta[1:])), np.sqrt(variance * np.linalg.eigvalsh(inverse[1:, 1:])[-1])
    if swing <= SURE * spread or swing <= len(r) * np.finfo(np.float64).eps:
        return None
    phase_deg = 180.0 - 2.0 * np.degrees(np.arctan2(beta[2], beta[1]))
    cross_deg = float(np.degrees(np.arcsin(min(swing, 1.0))))
    return {"phase_deg": float((phase_deg + 180.0) % 360.0 - 180.0), "cross_deg": cross_deg}


def _possible(shape: Shape, beta: FloatArray) -> bool:
    """Return whether both waves are as small as a_x says that they must be."""
    most_deg = shape.at.get("cross_deg", 90.0) + CROSS_AXIS_DEG
    largest = {
        "amplitude_deg": np.radians(most_deg) * most_deg / 4.0,
        "first_order_deg": np.radians(STEEPEST_DEG) * most_deg,
    }
    return all(abs(value) <= largest[name] for name, value in zip(shape.parameters, beta, strict=False))


def _on_reading_deg(p: Applied) -> FloatArray:
    waves = _waves(p.theta_deg, p.value("phase_deg"))
    return np.asarray(sum(p.value(name) * wave for name, wave in zip(NAMES, waves, strict=True)))


def _evidence(_r: Responses, shape: Shape) -> list[str]:
    if "cross_deg" not in shape.at:
        return []
    cross_deg = shape.at["cross_deg"]
    swing_mg = 1e3 * np.sin(np.radians(cross_deg))
    return [f"accel_x sees it: a swing of {swing_mg:.1f} mg, {cross_deg:.2f}° off the stage's axis"]


EFFECT = Effect(
    name="axis_tilt",
    title="Stage's axis and unit not square",
    origin="mounting",
    scope="run",
    covariate=ELEVATION,
    parameters=(
        Parameter("amplitude_deg", "Amplitude of the second order", "°"),
        Parameter("phase_deg", "Phase", "°"),
        Parameter("first_order_deg", "Amplitude of the first order", "°"),
        Parameter("cross_deg", "Unit's x axis off the stage's axis", "°"),
    ),
    formula="amplitude_deg·sin(2θ + phase_deg) − first_order_deg·cos(θ − 90° + phase_deg/2)",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight("it is of how the unit sat on the stage"),
    apart="accel_x swings with the elevation, |accelerometer| of three axes stays, the gyro sees nothing",
    remedy="level the stage's axis, and seat the unit square to it",
    evidence=_evidence,
    possible=_possible,
)
