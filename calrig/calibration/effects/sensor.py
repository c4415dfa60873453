"""What the sensor does: its two accelerometer axes, its temperature, its gyro."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effects.shape import DEG, Shape, effect, sin_cos, tilted, turns
from calrig.calibration.responses import MOVE, NORM, READING, Responses
from calrig.estimation.angles import FloatArray

MG = 1e-3
STEEPEST_DEG = 80.0
"""Beyond it a_y says next to nothing of the angle, and tan θ nothing of a_y."""


@effect(
    name="accelerometer_offset",
    origin="sensor",
    covariate="target_deg",
    apart="|accelerometer| changes as y·sin θ + z·cos θ",
    remedy="subtract the offsets in the firmware, or calibrate against gravity",
)
def accelerometer_offset(r: Responses) -> Iterator[Shape]:
    """Reading += y·cos θ − z·sin θ (rad per g): offsets of the two axes."""
    if not turns(r):
        return
    s, c = sin_cos(r)
    angle = np.stack([c, -s], 1) * DEG * MG
    norm = np.stack([s, c], 1) * MG
    yield from _one_or_both(angle, norm, ("y_mg", "z_mg"))


@effect(
    name="axis_mismatch",
    origin="sensor",
    covariate="target_deg",
    apart="|accelerometer| changes as gain·sin² θ and skew·sin θ·cos θ",
    remedy="correct gain and skew of the two axes in the firmware",
)
def axis_mismatch(r: Responses) -> Iterator[Shape]:
    """Reading += gain/2·sin 2θ and skew·cos² θ: a_y too long by the gain, a_y + a_z·sin(skew)."""
    if not turns(r):
        return
    s, c = sin_cos(r)
    angle = np.stack([s * c * DEG / 100.0, c * c], 1)
    norm = np.stack([s * s / 100.0, s * c / DEG], 1)
    yield from _one_or_both(angle, norm, ("gain_pct", "skew_deg"))


@effect(
    name="nonlinearity",
    origin="sensor",
    covariate="target_deg",
    apart="|accelerometer| changes as the error of the angle times tan θ",
    remedy="correct the angle by the polynomial",
)
def nonlinearity(r: Responses) -> Iterator[Shape]:
    """Reading += k₂·θ² + k₃·θ³, of an a_y that is wrong by cos θ times that."""
    theta = r.theta_deg
    if not turns(r):
        return
    angle = np.stack([theta**2, theta**3], 1)
    # an error of a_y that turns the angle by f lengthens the vector by f·tan θ
    norm = angle / DEG * np.tan(np.radians(np.clip(theta, -STEEPEST_DEG, STEEPEST_DEG)))[:, None]
    yield from _one_or_both(angle, norm, ("deg_per_deg2", "deg_per_deg3"))


def _one_or_both(angle: FloatArray, norm: FloatArray, names: tuple[str, str]) -> Iterator[Shape]:
    """Both columns together, and each alone: what one of them explains needs no second."""
    yield Shape({**tilted(angle), NORM: norm}, names, form="both")
    for k, name in enumerate(names):
        yield Shape({**tilted(angle[:, k]), NORM: norm[:, k]}, (name,), form=name)


@effect(
    name="temperature_bias",
    origin="sensor",
    covariate="temperature_c",
    apart="a second warm-up, or cooling back, tells temperature from time",
    remedy="wait until the unit is warm, or correct by its own thermometer",
)
def temperature_bias(r: Responses) -> Iterator[Shape]:
    """Reading += deg_per_c·(T − reference): the package turns, or an offset of the chip moves.

    Where |accelerometer| shows that it is the y axis's offset (`of_axis_y` is 1), times cos θ.
    """
    yield from _of_temperature(r, 1, "deg_per_c")
    warmer = warmer_c(r)
    if warmer is not None and NORM in r.channels and turns(r):
        s, c = sin_cos(r)
        yield Shape(
            {**tilted(warmer * c), NORM: warmer * s / DEG},
            ("deg_per_c",),
            form="axis_y",
            at={"reference_c": reference_c(r), "of_axis_y": 1.0},
            says="an offset of the accelerometer's y axis moves: what it adds falls with cos θ",
        )


@effect(
    name="temperature_curvature",
    origin="sensor",
    covariate="temperature_c",
    apart="what is left once the linear coefficient is taken out",
    remedy="correct by the unit's own thermometer with both terms",
    follows="temperature_bias",
)
def temperature_curvature(r: Responses) -> Iterator[Shape]:
    """Reading += deg_per_c2·(T − reference)², beyond the linear term."""
    yield from _of_temperature(r, 2, "deg_per_c2")


def _of_temperature(r: Responses, power: int, name: str) -> Iterator[Shape]:
    """A power of the temperature in the angle alone, or beside one of its own in |accelerometer|."""
    warmer = warmer_c(r)
    if warmer is None:
        return
    shift = 0.0
    if power == 2:  # about where the square says nothing of the linear coefficient, which keeps its value
        shift = float((warmer**3).sum() / (2.0 * (warmer**2).sum()))
    term = (warmer - shift) ** power
    at = {"reference_c": reference_c(r) + shift}
    yield Shape(tilted(term), (name,), form="package", at=at)
    if NORM in r.channels:  # an offset or gain that moves with temperature shows in |a| as well
        s, c = sin_cos(r)
        norm = np.column_stack([0.0 * term, term, *([term * s, term * c] if turns(r) else [])])
        angle = np.column_stack([term, np.zeros((len(r), norm.shape[1] - 1))])
        yield Shape({**tilted(angle), NORM: norm}, (name,), form="offset", at=at)


@effect(
    name="temperature_scale",
    origin="sensor",
    covariate="temperature_c",
    apart="grows with elevation and temperature together",
    remedy="wait until the unit is warm, or correct by its own thermometer",
)
def temperature_scale(r: Responses) -> Iterator[Shape]:
    """Reading += per_c·(T − reference)·θ."""
    warmer = warmer_c(r)
    if warmer is not None and turns(r):
        at = {"reference_c": reference_c(r)}
        yield Shape(tilted(warmer * r.theta_deg), ("per_c",), at=at)


def warmer_c(r: Responses) -> FloatArray | None:
    """Temperature less its mean, None where it does not vary."""
    if r.temperature_c is None or np.ptp(r.temperature_c) < 0.05:
        return None
    return np.asarray(r.temperature_c - r.temperature_c.mean(), dtype=np.float64)


def reference_c(r: Responses) -> float:
    """The temperature that coefficients of temperature refer to: the poses' mean."""
    return float("nan") if r.temperature_c is None else float(r.temperature_c.mean())


@effect(
    name="gyro_scale",
    origin="sensor",
    covariate="move_deg",
    apart="the gyro's own integral over the move is wrong by the same factor",
    remedy="correct the gyro's scale in the filter, or settle longer",
)
def gyro_scale(r: Responses) -> Iterator[Shape]:
    """Reading += κ·gain·move: the gyro's own scale error as far as the filter still shows it."""
    if MOVE in r.channels and np.abs(r.move_deg).max() > 0.0:
        moved = r.move_deg / 100.0
        shares = {READING: r.kappa * moved, MOVE: moved}
        yield Shape(shares, ("gain_pct",), replaces=f"{MOVE}.gain")
