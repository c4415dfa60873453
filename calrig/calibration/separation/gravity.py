"""Calibrate an accelerometer against gravity alone, without a stage: |a| = 1 g.

Effects are added to bias and scale by forward selection. The statistic is the maximum over all candidates,
its null distribution a bootstrap under the current model for these very poses, as in the diagnosis. Poses
laid down by hand come in any order, so that an effect's columns are rough, and correlation from pose to pose
does not resemble one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calrig.calibration.diagnosis.ranking import MARGIN
from calrig.calibration.gravity_fit import (
    EFFECTS,
    FEWEST_POSES,
    GravityEffect,
    GravityFit,
    Problem,
    consistent_poses,
    fit_gravity,
    linearised,
    undetermined_base,
)
from calrig.calibration.line import rms
from calrig.calibration.static_detector import outlier_limit, static_poses
from calrig.calibration.static_segments import GravityError, StaticPoses, step_of
from calrig.estimation.angles import AXES, FloatArray

BOOTSTRAPS = 999
SEED = 0
NEAR_1_G = (0.75, 1.25)
POSSIBLE_GAIN = (0.75, 1.25)
LARGEST_BIAS_G = 0.5
LARGEST_GAIN_STD = 0.05
LARGEST_BIAS_STD_G = 0.05
LARGEST_RESIDUAL_G = 0.02
"""What bias, gain and misalignment leave of a sensor at rest is less, but for its noise."""
NOISE_FACTOR = 3.0
RATE_DIFFERS = 0.01
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


FREEDOM = 3
"""Degrees of freedom that must be left beside a candidate."""
WIDTH = 3
"""Parameters of every candidate: one for each axis or pair of axes."""
LEVEL = 0.01
BOOTSTRAPS_HELD_OUT = 499
MOST_LEFT_OUT_ALONE = 200
FOLDS = 100
LEAST_FREEDOM_OF_A_POSE = 0.05
SMALLEST = 1e-12
LEAST_SHARE = 1e-7
"""Of a column's size, beyond which it is its own: the root of what a number is rounded to, and more."""


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """A significant effect, its family-wise p-value, and the names as likely as its own."""

    effect: GravityEffect
    p_value: float
    rivals: tuple[str, ...]


def poses_needed(fitted: GravityFit) -> int:
    """Return how many poses it takes to look for one more effect."""
    return len(fitted.beta) + WIDTH + FREEDOM


def search(
    problem: Problem, base: GravityFit, rng: np.random.Generator, bootstraps: int
) -> tuple[GravityFit, tuple[FoundEffect, ...]]:
    """Add effects to a fit of bias and scale one by one, until no candidate is significant."""
    found: list[FoundEffect] = []
    fitted = base
    problem = problem.sighted()
    offered = [effect for effect in EFFECTS if problem.shows(effect)]
    while offered and len(problem) >= poses_needed(fitted):
        ratios, p_value = _gate(problem, fitted, offered, rng, bootstraps)
        if p_value > LEVEL:
            break
        best = offered[int(np.argmax(ratios))]
        rivals = [
            effect.name
            for effect, ratio in zip(offered, ratios, strict=True)
            if effect is not best and ratios.max() - ratio < MARGIN
        ]
        found.append(FoundEffect(best, p_value, tuple(rivals)))
        offered.remove(best)
        fitted = fit_gravity(problem, [f.effect for f in found])
    return fitted, tuple(found)


def _gate(
    problem: Problem,
    fitted: GravityFit,
    candidates: Sequence[GravityEffect],
    rng: np.random.Generator,
    bootstraps: int,
) -> tuple[FloatArray, float]:
    """(C,) reductions of −2 log likelihood, and the p-value of their maximum in noise alone.

    Linear about the fit: residuals of a few mg leave terms of second order near 1e-5. The noise is drawn from
    the residuals, each freed of what the fit took from it (Davison & Hinkley, Bootstrap Methods and their
    Application, 1997, section 6.3), with random signs.
    """
    n, taken = len(problem), len(fitted.beta)
    basis, _ = np.linalg.qr(fitted.jacobian)
    leverage = (basis**2).sum(axis=1)
    noise = fitted.residual_g / np.sqrt(np.maximum(1.0 - leverage, LEAST_FREEDOM_OF_A_POSE))
    rounding_g = n * np.finfo(np.float64).eps * float(np.linalg.norm(problem.raw_g, axis=1).max())
    if np.sqrt((noise**2).mean()) < rounding_g:  # a log without noise: what is left is rounding
        noise = np.full(n, rounding_g)
    drawn = noise[rng.integers(0, n, (bootstraps, n))] * rng.choice([-1.0, 1.0], (bootstraps, n))
    values = np.vstack([fitted.residual_g, drawn])
    values = values - (values @ basis) @ basis.T
    power = (values**2).sum(axis=1) + n * rounding_g**2
    columns = problem.design([*fitted.effects, *candidates])
    _, seen = linearised(problem.raw_g, columns, fitted.beta)
    ratios = np.zeros((bootstraps + 1, len(candidates)))
    for k in range(len(candidates)):
        own = seen[:, taken + WIDTH * k : taken + WIDTH * (k + 1)]
        more = _beside(basis, own)
        left = power - ((values @ more) ** 2).sum(axis=1)
        ratios[:, k] = (n - taken - WIDTH) * np.log(power / np.maximum(left, SMALLEST * power))
    best = ratios.max(axis=1)
    return ratios[0], float((1 + (best[1:] >= best[0]).sum()) / (bootstraps + 1))


def _beside(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Orthonormal columns for what an orthonormal basis has not; what it has, but for rounding, is none."""
    left = columns - basis @ (basis.T @ columns)
    left = left - basis @ (basis.T @ left)  # once more: what the first subtraction left by rounding
    turned, values, _ = np.linalg.svd(left, full_matrices=False)
    return np.asarray(turned[:, values > LEAST_SHARE * np.linalg.norm(columns, 2)], dtype=np.float64)


def held_out_errors(
    problem: Problem, effects: Sequence[GravityEffect], rng: np.random.Generator
) -> tuple[str, FloatArray, FloatArray]:
    """Return how poses were held out, and (n,) errors in g before and after; a fold repeats search and fit.

    Up to 200 poses are left out one by one; of more, every 100th goes into one fold. Where no fold finds an
    effect, as one pose fewer may be too few to search, those of all poses are fitted again in each fold.
    """
    n = len(problem)
    folds = n if n <= MOST_LEFT_OUT_ALONE else FOLDS

    def errors_g(model_of: Callable[[Problem], GravityFit]) -> FloatArray:
        errors_g = np.zeros(n)
        for chosen in (np.arange(n) % folds == k for k in range(folds)):
            errors_g[chosen] = problem.rows(chosen).errors_g(model_of(problem.rows(~chosen)))
        return errors_g

    how = "leave one pose out" if folds == n else f"{folds} folds"
    before = errors_g(fit_gravity)
    after = errors_g(lambda others: search(others, fit_gravity(others), rng, BOOTSTRAPS_HELD_OUT)[0])
    if effects and np.array_equal(after, before):
        after = errors_g(lambda others: fit_gravity(others.sighted(), effects))
        how += ", with the effects of all poses"
    return how, before, after


@dataclass(frozen=True, slots=True)
class ExcludedPose:
    """A pose that disagrees with the others: its first and last sample, and |a| − 1 g by their fit."""

    first: int
    last: int
    error_g: float


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Calibration of an accelerometer against gravity.

    Attributes:
        poses: those that agree.
        excluded: those that do not.
        base: bias and scale alone.
        final: with the effects that were found.
        held_out: how the held-out errors were measured, in words.
        base_held_out_g: (n,) error of each pose by a fit without it.
        final_held_out_g: (n,) the same with effects.
    """

    poses: StaticPoses
    excluded: tuple[ExcludedPose, ...]
    base: GravityFit
    final: GravityFit
    found: tuple[FoundEffect, ...]
    held_out: str
    base_held_out_g: FloatArray
    final_held_out_g: FloatArray
    warnings: tuple[str, ...]


def calibrate_by_gravity(
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    rate_hz: float | None = None,
    gyro_dps: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
) -> Gravity:
    """Calibrate an accelerometer that was laid down in many attitudes by hand.

    Args:
        accel_g: (N, 3) samples of a log, or one or some rows for each position, in g; rows that are not
            finite are left out.
        time_s: (N,) not decreasing; None where not known.
        rate_hz: of the samples; it wins over `time_s`.
        gyro_dps: (N, 3), helps to tell static from moving.
        temperature_c: (N,) °C.

    Raises:
        GravityError: no motion, too few static poses, poses that do not determine bias and scale or
            contradict one another, values that are not g, or a rate that is not above 0.
    """
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise GravityError(f"the rate is {rate_hz} Hz; it must be above 0")
    whole = np.flatnonzero(np.isfinite(accel_g).all(axis=1))
    if not len(whole):
        raise GravityError("the log has no sample in which all three axes of the accelerometer are known")
    _refuse_other_units(accel_g[whole])
    warnings: list[str] = []
    if len(whole) < len(accel_g):
        warnings.append(f"{len(accel_g) - len(whole)} samples without all three axes were left out")
    if rate_hz is not None:
        warnings += _other_rate(rate_hz, time_s)
    time_s, gyro_dps, temperature_c = (
        None if column is None else column[whole] for column in (time_s, gyro_dps, temperature_c)
    )
    poses = static_poses(
        accel_g[whole], time_s=time_s, rate_hz=rate_hz, gyro_dps=gyro_dps, temperature_c=temperature_c
    )
    spans = np.column_stack([whole[poses.spans[:, 0]], whole[poses.spans[:, 1] - 1] + 1])
    poses = replace(poses, spans=spans, noise_g=_noise_g(poses, accel_g[whole]))
    return trace_gravity(poses, warnings=tuple(warnings))


def trace_gravity(
    poses: StaticPoses, *, bootstraps: int = BOOTSTRAPS, warnings: tuple[str, ...] = ()
) -> Gravity:
    """Fit bias and scale to static poses, then find the effects they lack, with family-wise p-values.

    Raises:
        GravityError: too few poses, poses that do not determine bias and scale or contradict one another, or
            a result that no accelerometer has.
    """
    _refuse_what_determines_nothing(poses)
    problem = Problem.of(poses)
    kept, errors_g = consistent_poses(problem)
    excluded = tuple(
        ExcludedPose(int(poses.spans[k, 0]), int(poses.spans[k, 1]) - 1, float(errors_g[k]))
        for k in np.flatnonzero(~kept)
    )
    if len(excluded) > outlier_limit(len(poses)):
        raise GravityError(
            f"{len(excluded)} of {len(poses)} poses contradict the others: was the sensor moved or its range "
            "exceeded in them? Take them again, at rest"
        )
    if excluded:
        poses = poses.rows(kept)
        problem = Problem.of(poses)
        _refuse_what_determines_nothing(poses)
    rng = np.random.default_rng(SEED)
    base = fit_gravity(problem)
    final, found = search(problem, base, rng, bootstraps)
    _refuse_the_impossible(final, poses)
    how, before, after = held_out_errors(problem, final.effects, rng)
    said = (*warnings, *([poses.finding] if poses.finding else ()), *_undetermined(problem, base))
    return Gravity(poses, excluded, base, final, found, how, before, after, said)


def gravity_document(gravity: Gravity, line_of: Callable[[int], int] | None = None) -> dict[str, Any]:
    """Return the document of `calrig gravity --json` (CONTRACT section 7), with `warnings`.

    `line_of` gives the line in the file of a sample; without it a pose is named by its samples, from 0.
    """
    base, final, n = gravity.base, gravity.final, len(gravity.poses)
    effects = [_effect_document(gravity, found) for found in gravity.found]
    verdicts = [effect["verdict"] for effect in effects]
    return {
        "n_poses": n,
        "held_out": {"how": gravity.held_out, "n_poses": n},
        "base": {
            "bias_g": base.bias_g.tolist(),
            "scale": base.gain.tolist(),
            "fit_rms_mg": MG * rms(base.residual_g),
            "held_out_rms_mg": MG * rms(gravity.base_held_out_g),
        },
        "verdict": "nothing" if not verdicts else "ambiguous" if "ambiguous" in verdicts else "named",
        "effects": effects,
        "final": {
            "bias_g": final.bias_g.tolist(),
            "bias_std_g": final.bias_std_g.tolist(),
            "scale": final.gain.tolist(),
            "scale_std": final.gain_std.tolist(),
            "matrix": final.matrix.tolist(),
            "fit_rms_mg": MG * rms(final.residual_g),
            "held_out_rms_mg": MG * rms(gravity.final_held_out_g),
        },
        "warnings": [*gravity.warnings, *(_exclusion(pose, line_of) for pose in gravity.excluded)],
    }


def _exclusion(pose: ExcludedPose, line_of: Callable[[int], int] | None) -> str:
    word, first, last = "row", pose.first, pose.last
    if line_of is not None:
        word, first, last = "line", line_of(pose.first), line_of(pose.last)
    where = f"{word} {first}" if first == last else f"{word}s {first} to {last}"
    return f"{where}: |a| is {MG * pose.error_g:+.1f} mg off 1 g by the fit of the other poses; left out"


def _effect_document(gravity: Gravity, found: FoundEffect) -> dict[str, Any]:
    effect, poses = found.effect, gravity.poses
    values, stds = gravity.final.parameters(effect, poses)
    parameters: dict[str, dict[str, float | None]] = {
        name: {"value": float(value), "std": float(std)} if np.isfinite(std) else {"value": None, "std": None}
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
        ways = ", ".join(f"{axis} up and {axis} down" for axis in sorted({name[-1] for name in blind}))
        raise GravityError(
            f"the {n} static poses do not determine {', '.join(blind)}: lay the sensor down with "
            f"{ways} as well"
        )


def _undetermined(problem: Problem, base: GravityFit) -> list[str]:
    pairs = problem.undetermined_pairs
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
    """Raise unless the median of |a|, which depends on no attitude, is near 1 g."""
    size = float(np.median(np.linalg.norm(accel_g, axis=1)))
    if NEAR_1_G[0] <= size <= NEAR_1_G[1]:
        return
    looks = next((words for about, words in UNITS.items() if abs(size / about - 1.0) < ALIKE), None)
    hint = f"the values look like {looks}" if looks else "check the unit and the range"
    raise GravityError(f"the median of |a| is {size:.4g} g where gravity is 1 g: {hint}")


def _refuse_the_impossible(fitted: GravityFit, poses: StaticPoses) -> None:
    """Raise if no accelerometer has these gains and biases, or the residual is far more than its noise."""
    advice = (
        "check the unit of each column and the rate (--rate), and keep the sensor at rest in every position"
    )
    known = zip(AXES, fitted.gain, fitted.gain_std, fitted.bias_g, fitted.bias_std_g, strict=True)
    for axis, gain, gain_std, bias_g, bias_std_g in known:
        if gain_std > LARGEST_GAIN_STD or bias_std_g > LARGEST_BIAS_STD_G:
            raise GravityError(
                f"{len(poses)} poses leave the gain of accel_{axis} uncertain by ±{gain_std:.2g}, its bias "
                f"by ±{bias_std_g:.2g} g: take more poses, at rest, on every side and on edges"
            )
        if not POSSIBLE_GAIN[0] <= gain <= POSSIBLE_GAIN[1]:
            raise GravityError(
                f"the gain of accel_{axis} would be {gain:.3f} ± {gain_std:.2g}, which no accelerometer in g "
                f"has ({POSSIBLE_GAIN[0]:g} to {POSSIBLE_GAIN[1]:g}): {advice}"
            )
        if abs(bias_g) > LARGEST_BIAS_G:
            raise GravityError(
                f"the bias of accel_{axis} would be {bias_g:+.3f} g, beyond ±{LARGEST_BIAS_G:g} g: {advice}"
            )
    left_g, noise_g = rms(fitted.residual_g), poses.noise_g or 0.0
    if left_g > max(LARGEST_RESIDUAL_G, NOISE_FACTOR * noise_g):
        noise = f"{MG * noise_g:.2g} mg in a pose" if noise_g else "the noise is not known"
        raise GravityError(
            f"bias, gain and what else was found leave {MG * left_g:.3g} mg (RMS) of |a| − 1 g over "
            f"{len(poses)} poses; at most {MG * LARGEST_RESIDUAL_G:g} mg are accepted, or "
            f"{NOISE_FACTOR:g} times the noise ({noise}): {advice}"
        )


def _noise_g(poses: StaticPoses, accel_g: FloatArray) -> float:
    """Return the noise of a pose: what its samples scatter by, or of one sample the rounding to a step."""
    return float(step_of(accel_g) / np.sqrt(12.0)) if poses.noise_g is None else poses.noise_g


def _other_rate(rate_hz: float, time_s: FloatArray | None) -> list[str]:
    step_s = float(np.nanmedian(np.diff(time_s))) if time_s is not None and len(time_s) > 1 else 0.0
    if step_s <= 0.0 or abs(rate_hz * step_s - 1.0) <= RATE_DIFFERS:
        return []
    return [f"the rate given, {rate_hz:.6g} Hz, is not the {1.0 / step_s:.6g} Hz of time_s; it is used"]
