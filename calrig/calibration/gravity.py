"""Gravity as the reference, where there is no stage: bias and scale from |a| = 1 g, and what they lack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.fit import rms
from calrig.calibration.gravity_model import (
    GravityFit,
    Problem,
    fit_gravity,
    undetermined_base,
    undetermined_pairs,
)
from calrig.calibration.gravity_search import FoundEffect, leave_one_out, poses_needed, search
from calrig.calibration.static_detector import GravityError, StaticPoses, static_poses
from calrig.estimation.angles import FloatArray

__all__ = ["Gravity", "GravityError", "calibrate_by_gravity", "gravity_document", "trace_gravity"]

FEWEST_POSES = 9
"""Six unknowns, and something left to judge them by when one pose is left out."""
BOOTSTRAPS = 999
SEED = 0
NEAR_1_G = (0.75, 1.25)
MG = 1e3
ALIKE = 0.2
UNITS = {
    9.80665: "m/s²: name the columns accel_x_mps2, accel_y_mps2, accel_z_mps2",
    1.0 / 9.80665: "g in columns named _mps2: name them accel_x_g, accel_y_g, accel_z_g",
    1000.0: "mg: divide them by 1000",
    16384.0: "counts of ±2 g: name the columns accel_x_lsb, … and give the range 2",
    8192.0: "counts of ±4 g: name the columns accel_x_lsb, … and give the range 4",
    4096.0: "counts of ±8 g: name the columns accel_x_lsb, … and give the range 8",
    2048.0: "counts of ±16 g: name the columns accel_x_lsb, … and give the range 16",
    0.25: "counts of a range four times as large: check the range",
    0.5: "counts of a range twice as large: check the range",
    2.0: "counts of a range half as large: check the range",
    4.0: "counts of a range a quarter as large: check the range",
}


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """What gravity says of an accelerometer; held-out errors (n,) in g, each pose by a search without it."""

    poses: StaticPoses
    base: GravityFit
    final: GravityFit
    found: tuple[FoundEffect, ...]
    base_held_out_g: FloatArray
    final_held_out_g: FloatArray
    warnings: tuple[str, ...]


def calibrate_by_gravity(
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    gyro_dps: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
) -> Gravity:
    """Calibrates an accelerometer from a log in which it was laid down in many attitudes by hand.

    Args:
        accel_g: (N, 3) samples in g; rows that are not finite are left out.
        time_s: (N,) increasing.
        gyro_dps: (N, 3), helps to tell static from moving.
        temperature_c: (N,) °C.

    Raises:
        GravityError: no motion, too few static poses, poses that do not determine bias and scale, or values
            that are not g.
    """
    whole = np.isfinite(accel_g).all(axis=1)
    if not whole.any():
        raise GravityError("the log has no sample in which all three axes of the accelerometer are known")
    kept = [None if c is None else c[whole] for c in (time_s, gyro_dps, temperature_c)]
    _refuse_other_units(accel_g[whole])
    poses = static_poses(accel_g[whole], time_s=kept[0], gyro_dps=kept[1], temperature_c=kept[2])
    lost = int((~whole).sum())
    said = (f"{lost} samples without all three axes were left out",) if lost else ()
    return trace_gravity(poses, warnings=said)


def trace_gravity(
    poses: StaticPoses, *, bootstraps: int = BOOTSTRAPS, warnings: tuple[str, ...] = ()
) -> Gravity:
    """Fits bias and scale to static poses, then finds what they lack, with family-wise p-values.

    Raises:
        GravityError: too few poses, or poses that do not determine bias and scale.
    """
    _refuse_what_determines_nothing(poses)
    rng = np.random.default_rng(SEED)
    problem = Problem.of(poses)
    base = fit_gravity(problem)
    final, found = search(problem, base, rng, bootstraps)
    before, after = leave_one_out(problem, rng)
    return Gravity(poses, base, final, found, before, after, (*warnings, *_undetermined(problem, base)))


def gravity_document(gravity: Gravity) -> dict[str, Any]:
    """CONTRACT section 7's `calrig gravity --json`, with `warnings` beside it."""
    base, final, n = gravity.base, gravity.final, len(gravity.poses)
    effects = [_effect_document(gravity, found) for found in gravity.found]
    verdicts = [effect["verdict"] for effect in effects]
    return {
        "n_poses": n,
        "held_out": {"how": "leave one pose out", "n_poses": n},
        "base": {
            "bias_g": base.bias_g.tolist(),
            "scale": (1.0 / np.diag(base.matrix)).tolist(),
            "fit_rms_mg": MG * rms(base.residual_g),
            "held_out_rms_mg": MG * rms(gravity.base_held_out_g),
        },
        "verdict": "nothing" if not verdicts else "ambiguous" if "ambiguous" in verdicts else "named",
        "effects": effects,
        "final": {
            "bias_g": final.bias_g.tolist(),
            "matrix": final.matrix.tolist(),
            "fit_rms_mg": MG * rms(final.residual_g),
            "held_out_rms_mg": MG * rms(gravity.final_held_out_g),
        },
        "warnings": list(gravity.warnings),
    }


def _effect_document(gravity: Gravity, found: FoundEffect) -> dict[str, Any]:
    effect, poses = found.effect, gravity.poses
    values, stds = gravity.final.parameters(effect, poses)
    parameters: dict[str, dict[str, float | None]] = {
        name: {"value": float(value), "std": float(std)}
        for name, value, std in zip(effect.parameters, values, stds, strict=True)
    }
    parameters |= {name: {"value": value, "std": None} for name, value in effect.reference(poses).items()}
    return {
        "name": effect.name,
        "title": effect.title,
        "verdict": "ambiguous" if found.rivals else "named",
        "origin": effect.origin,
        "covariate": effect.covariate,
        "parameters": parameters,
        "p_value": found.p_value,
        "confusable_with": list(found.rivals),
        "remedy": effect.remedy,
    }


def _refuse_what_determines_nothing(poses: StaticPoses) -> None:
    n = len(poses)
    if n == 1:
        raise GravityError(
            "the log is one static pose: nothing was turned; lay the sensor down in "
            f"{FEWEST_POSES} or more attitudes, on every side and on edges, a few seconds each"
        )
    if n < FEWEST_POSES:
        raise GravityError(
            f"{n} static poses are too few: at least {FEWEST_POSES} are needed (six unknowns, and something "
            "to judge them by), each at rest for two seconds and more"
        )
    blind = undetermined_base(poses)
    if blind:
        raise GravityError(
            f"the {n} static poses do not determine {', '.join(blind)}: lay the sensor down with "
            f"{_both_ways({name[-1] for name in blind})} as well"
        )


def _both_ways(axes: set[str]) -> str:
    return ", ".join(f"{axis} up and {axis} down" for axis in sorted(axes))


def _undetermined(problem: Problem, base: GravityFit) -> list[str]:
    """What these poses cannot show, in words."""
    pairs = undetermined_pairs(problem, base)
    said = []
    if pairs:
        said.append(
            f"misalignment {', '.join(pairs)} cannot be seen and was not looked for: tilt the sensor "
            f"between {', '.join(f'{pair[0]} and {pair[1]}' for pair in pairs)} in some poses"
        )
    elif len(problem) < poses_needed(base):
        said.append(f"{len(problem)} static poses do not show misalignment: {poses_needed(base)} are needed")
    return said


def _refuse_other_units(accel_g: FloatArray) -> None:
    """|a| of the middle sample is near 1 g, whatever the attitude, or the values are of another unit."""
    size = float(np.median(np.linalg.norm(accel_g, axis=1)))
    if NEAR_1_G[0] <= size <= NEAR_1_G[1]:
        return
    looks = next((words for about, words in UNITS.items() if abs(size / about - 1.0) < ALIKE), None)
    hint = f"the values look like {looks}" if looks else "check the unit and the range"
    raise GravityError(f"|a| is {size:.4g} g in the middle of the log where gravity is 1 g: {hint}")
