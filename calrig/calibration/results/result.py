"""A run's result as CONTRACT section 2 gives it, from its poses."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from calrig.calibration.line import JointErrors, Line, fit_line, residuals_deg, rms, strays
from calrig.calibration.poses import Pose, of_first_mount
from calrig.calibration.regression.effect import ApplyError
from calrig.calibration.results.correction import (
    SMALL,
    AppliedEffect,
    effects_on_reading_deg,
    felt_elevation_deg,
    fit_line_with_effects,
    of_unit,
    unit_slopes,
)
from calrig.calibration.results.pose_errors import (
    angles_deg,
    as_clamped,
    circumstances,
    corrected_residuals_deg,
    nominal_deg,
    raw_error_deg,
    without_effects_deg,
)
from calrig.calibration.uncertainty.budget import over_range, reference_figures, trapezoids
from calrig.calibration.uncertainty.sequential_stopping import AS_PLANNED, Ending, cautious, widened
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.model.result import Extremes, Gyro, Reference, ReferenceFigures, Result

RELATIVE = (
    "The solution that was verified does not know the level: errors are less their mean over the poses."
)
SMALLEST = 1e-300
"""Of a variance: what makes that of exact readings a number."""
MOST_NAMED = 3
"""Poses far from the others that a sentence names."""

UNKNOWN_GYRO = Gyro(bias_dps=[None] * 3, bias_std_dps=[None] * 3, scale=None, scale_std=None)
"""Of poses without samples of the gyro."""


@dataclass(frozen=True, slots=True)
class EffectDoubt:
    """How well effects are known that are taken out of a run.

    Attributes:
        stds: of each effect, the standard errors of its parameters by name.
        run_offset_std_deg: between days and clampings; 0 where it is not known.
        fitted_here: parameters that were fitted to the very poses that the effects are taken out of.
        factors: of each effect, by parameter, the rows of a triangular matrix L, where their covariance is
            known as L·Lᵀ; the parameters of an effect without rows are taken as uncorrelated.
    """

    stds: Sequence[Mapping[str, float]]
    run_offset_std_deg: float = 0.0
    fitted_here: int = 0
    factors: Sequence[Mapping[str, Sequence[float]]] = ()

    def steps(self) -> list[list[Mapping[str, float]]]:
        """Changes of all parameters, by effect; the sum of their outer products is the covariance."""
        factors = self.factors or [{} for _ in self.stds]
        width = max((len(row) for rows in factors for row in rows.values()), default=0)
        together: list[list[Mapping[str, float]]] = [
            [{name: row[column] for name, row in rows.items() if column < len(row)} for rows in factors]
            for column in range(width)
        ]
        alone: list[list[Mapping[str, float]]] = [
            [{name: std} if one == k else {} for one in range(len(self.stds))]
            for k, stds in enumerate(self.stds)
            for name, std in stds.items()
            if name not in factors[k]
        ]
        return together + alone


class FittedResult(Result):
    """A result with the fit that it is from.

    Attributes:
        line: with covariance and residual scatter, for the unit's calibration.
        line_with_effects: the same once accepted effects are taken out; None without any.
    """

    line: Line = Field(repr=False, exclude=True)
    line_with_effects: Line | None = Field(default=None, repr=False, exclude=True)


def build_result(
    poses: Sequence[Pose],
    gyro: Gyro | None = None,
    effects: Sequence[AppliedEffect] = (),
    reference: Reference | None = None,
    reference_says: str | None = None,
    ending: Ending = AS_PLANNED,
    doubt: EffectDoubt | None = None,
) -> FittedResult:
    """Fit a run's poses and gather their result; of several mounts, the first one's.

    Args:
        poses: those that count (none excluded), at least one.
        gyro: what the run's samples say of the gyro, where there are any.
        effects: accepted for the unit or the rig; `line_with_effects` is None where the poses lack what one
            of them is a function of.
        reference: what the rig said of its stage when the poses were measured.
        reference_says: why it is not the stage's map.
        ending: how the run came to its end; the scatter of one that might end early is stated with care.
        doubt: how well the effects are known; exactly where it is None.

    Raises:
        ValueError: no pose, or one whose angle or reading is not finite.
    """
    poses = of_first_mount(poses)
    theta, reading = angles_deg(poses)
    one_angle = len({pose.target_deg for pose in poses}) == 1
    line = fit_line(theta, reading, one_angle=one_angle)
    with_effects = _line_with_effects(poses, theta, reading, effects)
    calibrated_deg = line.left_deg(theta, reading)
    noise_deg = _pooled_noise_deg(poses)
    if with_effects is not None and doubt is not None:
        with_effects = _with_fewer_degrees(with_effects[0], len(poses), doubt.fitted_here), with_effects[1]
    if ending.may_be_early:
        line = cautious(line, len(poses), noise_deg)
        if with_effects is not None:
            with_effects = cautious(with_effects[0], len(poses), noise_deg), with_effects[1]
    if with_effects is not None and doubt is not None:
        with_effects = _doubted(with_effects[0], poses, effects, doubt), with_effects[1]
    left = (line, calibrated_deg) if with_effects is None else with_effects
    return FittedResult(
        bias_deg=line.bias_deg,
        bias_std_deg=line.bias_std_deg,
        scale=line.scale,
        scale_std=line.scale_std,
        rms_raw_deg=rms(np.array([raw_error_deg(pose, bias_deg=line.bias_deg) for pose in poses])),
        rms_calibrated_deg=_known(rms(calibrated_deg)),
        rms_with_effects_deg=None if with_effects is None else _known(rms(with_effects[1])),
        n_poses=len(poses),
        noise_deg=noise_deg,
        temperature_c=_temperature_range(poses),
        gyro=gyro or UNKNOWN_GYRO,
        reference=None if reference is None else reference_figures(theta, left[0], reference),
        over_range=over_range(theta, left[1], left[0], reference, noise_deg, nominal_deg(poses)),
        line=line,
        line_with_effects=None if with_effects is None else with_effects[0],
        reference_says=reference_says,
        stopped_by=ending.stopped_by,
        far_says=_far_in_words(poses, left[1]),
    )


def _far_in_words(poses: Sequence[Pose], left_deg: FloatArray) -> str | None:
    """Say which poses are far from what the others say, of what calibration leaves (n,); None of none."""
    far = strays(*angles_deg(poses), left_deg).tolist()
    if not far:
        return None
    shown = ", ".join(f"{poses[k].reading_deg:g}° at {poses[k].target_deg:g}°" for k in far[:MOST_NAMED])
    more = f" and {len(far) - MOST_NAMED} more" if len(far) > MOST_NAMED else ""
    return (
        f"Far from the line of the other poses: readings of {shown}{more}. Bias and scale follow them: "
        "exclude what is an error of reading."
    ).replace("-", "−")


def apply_calibration(
    poses: Sequence[Pose],
    gyro: Gyro | None,
    line: Line,
    effects: Sequence[AppliedEffect],
    reference: ReferenceFigures | None = None,
    *,
    clamped_anew: bool = False,
) -> FittedResult:
    """What a calibration made earlier leaves of a run's poses: nothing is fitted, all of it is verified.

    Args:
        poses: those that count, at least one.
        gyro: as for `build_result`.
        line: bias and scale in force, fitted together with the effects.
        effects: in force.
        reference: the stage's part of that bias and scale, from the run that they were fitted to.
        clamped_anew: the calibration says nothing of how the unit is clamped: errors are less their mean.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    poses = of_first_mount(poses)
    theta, reading = angles_deg(poses)
    applied = as_clamped(poses, line, effects) if clamped_anew else line
    bare = as_clamped(poses, line, ()) if clamped_anew else line
    without = without_effects_deg(poses, applied, effects)
    left_deg = corrected_residuals_deg(poses, applied, effects)
    fresh = build_result(poses, gyro)
    return fresh.model_copy(
        update={
            "bias_deg": line.bias_deg,
            "bias_std_deg": line.bias_std_deg,
            "scale": line.scale,
            "scale_std": line.scale_std,
            "rms_calibrated_deg": _known(rms(residuals_deg(theta, reading, bare.bias_deg, bare.scale))),
            "rms_with_effects_deg": _known(rms(left_deg)) if effects else None,
            "reference": reference,
            "over_range": over_range(
                theta,
                left_deg,
                fit_line(theta, without, one_angle=fresh.scale is None),
                None if reference is None else reference.reference,
                fresh.noise_deg,
                nominal_deg(poses),
            ),
            "line": line,
            "reference_says": RELATIVE if clamped_anew else None,
            "far_says": None,  # nothing follows a pose
        }
    )


def _line_with_effects(
    poses: Sequence[Pose], theta: FloatArray, reading: FloatArray, effects: Sequence[AppliedEffect]
) -> tuple[Line, FloatArray] | None:
    """Bias and scale once the effects are taken out, and (n,) what is left; None where they cannot be."""
    if not effects:
        return None
    given = circumstances(poses)
    try:
        line = fit_line_with_effects(theta, reading, effects, given)
        error_deg = corrected_residuals_deg(poses, line, effects)
        slopes = unit_slopes(theta + error_deg, line, effects, given)
    except ApplyError:
        return None
    if not line.follows or np.isnan(error_deg).any():
        return line, np.full(len(error_deg), math.nan)
    return replace(line, slope=1.0 / rms(1.0 / slopes)), error_deg


def _with_fewer_degrees(line: Line, n_poses: int, fitted: int) -> Line:
    """Return the line with scatter and covariance of n − 2 − `fitted` degrees of freedom, of 1 at least."""
    fitted = min(fitted, n_poses - 3)
    if fitted <= 0 or line.covariance is None or line.residual_std_deg is None:
        return line
    more = math.sqrt((n_poses - 2) / (n_poses - 2 - fitted))
    return replace(widened(line, more), effect_parameters=fitted)


def _doubted(line: Line, poses: Sequence[Pose], effects: Sequence[AppliedEffect], doubt: EffectDoubt) -> Line:
    """The line with the covariance of the effects' parameters in its own, and beside it.

    With X the columns of bias and scale, and Z those of the effects, whose parameters γ have the covariance
    P, the line fitted to the readings less Z·γ has s²·(XᵀX)⁻¹ + H·P·Hᵀ, H = (XᵀX)⁻¹XᵀZ, and −H·P with γ. A
    fit of all of them together has the same (block inverse of the normal equations). H is by central
    differences.
    """
    if line.covariance is None:
        return line
    theta, reading = angles_deg(poses)
    given, changes = circumstances(poses), doubt.steps()
    own = np.linalg.cholesky(np.array(line.covariance) + np.diag(np.full(2, SMALLEST))).T
    steps = [*own, np.array([doubt.run_offset_std_deg, 0.0])]
    felt_deg = felt_elevation_deg(theta, line.bias_deg, line.scale)
    added = [steps[k] @ np.stack([np.ones_like(theta), theta]) for k in range(3)]
    for step in changes:
        ends = [_changed(effects, step, side) for side in (SMALL, -SMALL)]
        above, below = (fit_line_with_effects(theta, reading, end, given, doubts=False) for end in ends)
        bias_deg = float(wrap_deg(above.bias_deg - below.bias_deg)) / (2.0 * SMALL)
        scale = ((above.scale or 1.0) - (below.scale or 1.0)) / (2.0 * SMALL)
        steps.append(np.array([bias_deg, scale]))
        over, under = (effects_on_reading_deg(of_unit(end), theta, given, felt_deg) for end in ends)
        added.append(bias_deg + scale * theta + (over - under) / (2.0 * SMALL))
    (of_bias, shared), (_, of_scale) = (np.transpose(steps) @ steps).tolist()
    return replace(
        line,
        covariance=((of_bias, shared), (shared, of_scale)),
        bias_std_deg=math.sqrt(of_bias),
        scale_std=math.sqrt(of_scale),
        errors=_joint_errors(steps, changes, effects, added / unit_slopes(theta, line, effects, given), theta)
        if changes
        else None,
    )


def _changed(
    effects: Sequence[AppliedEffect], step: Sequence[Mapping[str, float]], share: float
) -> list[AppliedEffect]:
    """Return the effects with parameters changed by a share of a step."""
    return [
        (name, {**values, **{key: values[key] + share * by for key, by in one.items()}})
        for (name, values), one in zip(effects, step, strict=True)
    ]


def _joint_errors(
    of_line: Sequence[FloatArray],
    changes: Sequence[Sequence[Mapping[str, float]]],
    effects: Sequence[AppliedEffect],
    elevation_deg: FloatArray,
    theta_deg: FloatArray,
) -> JointErrors:
    """Return the steps of line and unit's effects together; the mean is over the range, not over poses."""
    own = [k for k, one in enumerate(effects) if of_unit([one])]
    of_unit_alone = [[change[k] for k in own] for change in changes]
    named = dict.fromkeys(
        (k, name) for change in of_unit_alone for k, one in enumerate(change) for name in one
    )
    beside = [[change[k].get(name, 0.0) for k, name in named] for change in of_unit_alone]
    before = np.zeros((len(of_line) - len(changes), len(named)))
    steps = np.column_stack(
        [of_line, np.concatenate([before, np.reshape(beside, (len(changes), len(named)))])]
    )
    places, which = np.unique(theta_deg, return_inverse=True)
    weight = (trapezoids(places) / np.bincount(which))[which]
    return JointErrors(tuple(named), steps, elevation_deg, float(weight @ (elevation_deg**2).sum(axis=0)))


def _pooled_noise_deg(poses: Sequence[Pose]) -> float | None:
    """√(mean squared standard error) of the poses that have one."""
    known = [error for pose in poses if (error := pose.reading_stderr_deg) is not None]
    return math.sqrt(sum(error * error for error in known) / len(known)) if known else None


def _temperature_range(poses: Sequence[Pose]) -> Extremes | None:
    known = [temperature for pose in poses if (temperature := pose.temperature_c) is not None]
    return Extremes(min=min(known), max=max(known)) if known else None


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
