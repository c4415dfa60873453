"""The diagnosis: what is left after bias and scale, traced to an effect, with the error before and after."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.conclusion import conclude
from calrig.calibration.diagnosis.established import established
from calrig.calibration.diagnosis.experiment_design import ambiguous_of, design
from calrig.calibration.diagnosis.held_out import (
    BLOCKS,
    FOLDS,
    TIME,
    Blocked,
    CrossValidation,
    blocked,
    confirm,
    cross_validate,
    not_predictive,
    standing_without_one,
    without_harm,
    worse,
)
from calrig.calibration.diagnosis.lack_of_fit import LackOfFit, lack_of_fit, warning_of
from calrig.calibration.diagnosis.outliers import beyond, gross_errors, most_outliers
from calrig.calibration.diagnosis.report import (
    effect_documents,
    fitted_scale,
    left_deg,
    model_words,
    turns_round,
)
from calrig.calibration.diagnosis.reselection import competing_candidates
from calrig.calibration.diagnosis.selection import Findings, search
from calrig.calibration.effects.stage_periodic import unsearched
from calrig.calibration.line import FARTHEST_STD_DEG, MIN_SCALE, Line, fit_line, rms
from calrig.calibration.poses import DiagnosisError, Pose, complete
from calrig.calibration.progress import Progress, unheard, within
from calrig.calibration.regression.channels import ANGLE
from calrig.calibration.regression.column_units import TIMES
from calrig.calibration.regression.effect import APPROACH
from calrig.calibration.regression.motion import DERIVED_APPROACH, with_approach
from calrig.calibration.regression.noise_model import lag1_correlation
from calrig.calibration.regression.request import AS_USUAL, DiagnosisRequest
from calrig.calibration.regression.responses import Responses, names_of, responses_of
from calrig.estimation.angle_text import angle_text
from calrig.estimation.angles import FloatArray

BOOTSTRAPS = 999
MOST_POSES = 4_000
"""A hundred name an effect of the size of the noise. Each thousand takes 10–20 s of a core and 140 MB, a few
times as long on a small machine or where the noise wanders.
"""
UNSEEN = 3.0
"""How many times as far as the accelerometer's angle a reading strays that gravity does not account for."""
LISTED = 5
"""Outliers that a warning lists; a burst has many."""
WEAKEST_FIRST = ("ambiguous", "unnamed", "named")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found in some poses, before it is put into words.

    Attributes:
        runs: the poses it rests on: those that are complete, less outliers.
        findings: the effects, and the fit of the final model.
        held_out: errors on held-out poses, before and after; None where they were not asked for.
        blocks: the same of poses held out in contiguous blocks; empty where they were not asked for.
        lack: what the final model leaves, against the pure error.
        warnings: what was left out or looked odd.
    """

    runs: tuple[tuple[Pose, ...], ...]
    findings: Findings
    held_out: CrossValidation | None
    blocks: tuple[Blocked, ...]
    lack: LackOfFit
    warnings: tuple[str, ...]


def diagnose(
    runs: Sequence[Sequence[Pose]],
    run_ids: Sequence[str] | None = None,
    *,
    request: DiagnosisRequest = AS_USUAL,
    seed: int = 0,
    bootstraps: int = BOOTSTRAPS,
    cross_fit: bool = True,
    progress: Progress = unheard,
) -> Diagnosis:
    """Trace what bias and scale leave of the poses to the effects the model lacks.

    Args:
        runs: the poses of one or several runs of a unit, in the order measured, none excluded.
        run_ids: what the runs are called, for what changed between two of them; else counted from 0.
        request: whether the reference may err, and known periods.
        seed: of the bootstrap: the same poses and seed give the same diagnosis.
        bootstraps: of each step of the search.
        cross_fit: whether the errors before and after are measured on held-out poses.
        progress: is called with the share of searches done: over all poses, then in each fold.

    Raises:
        DiagnosisError: the poses cannot be diagnosed; the message says why.
    """
    given, incomplete = complete(runs)
    if (n_poses := sum(map(len, given))) > MOST_POSES:
        fewer = f"give one row in {math.ceil(n_poses / MOST_POSES)}, or means of neighbouring rows"
        raise DiagnosisError(f"{n_poses:,} poses; at most {MOST_POSES:,} are diagnosed: {fewer}")
    whole, is_derived = with_approach(given)
    r = responses_of(whole, names_of(runs, given, run_ids), request)
    right = np.delete(np.arange(len(r)), gross_errors(r))
    r = r.rows(right)
    candidates = candidates_of(r)
    rng = np.random.default_rng(seed)
    findings = established(search(r, candidates, rng, bootstraps=bootstraps), draws=True)
    kept, outliers = _parted(whole, right[findings.kept])
    left = findings.responses
    findings = replace(findings, found=standing_without_one(left, findings.found))
    _require_that_readings_follow(findings)
    held_out: CrossValidation | None = None
    blocks: tuple[Blocked, ...] = ()
    harm: list[str] = []
    if cross_fit:
        of_kept = [c.rows(findings.kept) for c in candidates]
        of_folds = within(progress, 1.0 / (1.0 + FOLDS), 1.0)  # the search over all poses has been done
        rivals = competing_candidates(left, of_kept, findings.found, beside_curve=findings.beside_curve)
        held_out = cross_validate(left, of_kept, rng, rivals, findings.noises, of_folds)
        findings, held_out, harm = without_harm(findings, held_out)
        if harm:  # what is left is judged without the effects that left
            findings = established(findings, draws=True)
            held_out = held_out if findings.found else held_out.of_nothing()
        predictive = not_predictive(left, findings.found, findings.fitted, of_kept)
        findings = replace(findings, found=predictive)
        blocks = blocked(left, [f.candidate for f in findings.found])
    _require_that_readings_follow(findings)  # without what has left since, too
    lack = _lack_of_fit(kept, findings)
    has_temperature = any(pose.temperature_c is not None for run in kept for pose in run)
    in_order = not left.starts.all()
    said = warning_of(lack, found=bool(findings.found), temperature=has_temperature, in_order=in_order)
    told = filter(None, (said, _unseen_by_gravity(findings), _undone(findings), unsearched(r)))
    accepted = [f.candidate for f in findings.found]
    most, more = most_outliers(len(r)), beyond(left, accepted, findings.fitted.residuals[:, 0])
    if len(more) and len(r) - len(left) + len(more) > most:
        flat = [pose for run in kept for pose in run]
        listed = "; ".join(_as_read(flat[k]) for k in more[:LISTED].tolist())
        poses = "1 more pose lies" if len(more) == 1 else f"{len(more)} more poses lie"
        outliers.append(
            f"{poses} as far from what the model says; at most {most} of {len(r)} are left out: look at "
            f"reading_deg, and leave out what is wrong ({listed}{' …' if len(more) > LISTED else ''})"
        )
    derived = [DERIVED_APPROACH] if is_derived and _rests_on_approach(findings) else []
    warnings = (*outliers, *incomplete, *derived, *r.warnings, *harm, *told)
    return Diagnosis(kept, findings, held_out, blocks, lack, warnings)


def _rests_on_approach(findings: Findings) -> bool:
    suspects = [one for f in findings.found for one in (f.candidate, *f.rivals)]
    return any(APPROACH.name in one.covariate.split(TIMES) for one in suspects)


def _lack_of_fit(kept: Sequence[Sequence[Pose]], findings: Findings) -> LackOfFit:
    r = findings.responses
    residual_deg = _after_deg(findings) if findings.found else _before(r)[1]
    freed = "reading.first" in r.base_names
    of_reading = int(np.any(findings.columns[:, 0, :] != 0.0, axis=0).sum())
    return lack_of_fit(
        kept,
        residual_deg,
        r.starts & freed,
        parameters=of_reading - freed * int(r.starts.sum()),
        lag1_correlation=lag1_correlation(residual_deg, float(r.rounding[0])),
        rounding_deg=float(r.rounding[0]),
    )


def _unseen_by_gravity(findings: Findings) -> str | None:
    """That the reading strays where the accelerometer does not; None where it does not, or nothing tells."""
    r = findings.responses
    if ANGLE not in r.channels:
        return None
    residuals = findings.fitted.residuals
    reading_deg, angle_deg = rms(residuals[:, 0]), rms(residuals[:, r.channels.index(ANGLE)])
    if reading_deg <= UNSEEN * angle_deg:
        return None
    return (
        f"the reading strays by {angle_text(reading_deg, 2)} (RMS) where the accelerometer's angle "
        f"strays by {angle_text(angle_deg, 2)}: gravity does not see what moves it, so look at "
        "what filters the reading, or leave out the accelerometer's columns where they are of another sensor"
    )


def _undone(findings: Findings) -> str | None:
    """That no calibration corrects readings that turn back; None where each stands for one elevation."""
    accepted = [f.candidate for f in findings.found]
    if not turns_round(findings.responses, accepted, findings.fitted.beta):
        return None
    return (
        "with these errors the readings turn back while the elevation goes on: one reading stands for "
        "several elevations, and no calibration tells which"
    )


def _require_that_readings_follow(findings: Findings) -> None:
    """Raise DiagnosisError where the readings may be the same, or noise, at every elevation."""
    r = findings.responses
    line = fit_line(r.theta_deg, r.theta_deg + r.values[:, 0])
    explained = findings.found and (line.residual_std_deg or 0.0) < FARTHEST_STD_DEG
    if abs(fitted_scale(r, findings.fitted.beta)) >= MIN_SCALE and (explained or line.follows):
        return
    raise DiagnosisError(
        f"the readings are not seen to follow the {np.ptp(r.theta_deg):.4g}° that the elevation turns: look "
        "at reading_deg, at its unit and at what fills it, or turn further"
    )


def _as_read(pose: Pose) -> str:
    return f"at {pose.target_deg:g}°, which reads {pose.reading_deg:g}°"


def _parted(
    runs: Sequence[Sequence[Pose]], used: npt.NDArray[np.intp]
) -> tuple[tuple[tuple[Pose, ...], ...], list[str]]:
    """Return the poses of runs that are used, by their places, and a sentence on the others of each."""
    kept, said, first = [], [], 0
    for number, run in enumerate(runs):
        where = f" of run {number}" if len(runs) > 1 else ""
        kept.append(tuple(pose for k, pose in enumerate(run, first) if k in used))
        left = [f"pose {k - first} {_as_read(pose)}" for k, pose in enumerate(run, first) if k not in used]
        if left:
            many = f"outliers{where}, {len(left)} poses" if len(left) > 1 else f"outlier{where}"
            more = f" and {len(left) - LISTED} more" if len(left) > LISTED else ""
            those = "; ".join(left[:LISTED])
            said.append(f"{many} far from what the model says, left out: {those}{more}")
        first += len(run)
    return tuple(kept), said


def document(diagnosis: Diagnosis, run_ids: Sequence[str]) -> dict[str, Any]:
    """Return the diagnosis as CONTRACT section 5 has it, without follow-up and confirmation."""
    findings = diagnosis.findings
    r = findings.responses
    before, before_deg = _before(r)
    after_deg = _after_deg(findings)
    effects = effect_documents(r, findings)
    verdicts = [effect["verdict"] for effect in effects]
    held_out, blocks = diagnosis.held_out, diagnosis.blocks
    worst = worse(blocks)
    return {
        "runs": list(run_ids),
        "reference": r.request.reference,
        "known_periods_deg": list(r.known_periods_deg),
        "n_poses": len(r),
        "held_out": {
            "how": "not measured" if held_out is None else _how(r, held_out, blocks),
            "n_poses": 0 if held_out is None else len(r),
        },
        "noise": _noise(diagnosis.lack),
        "base": {
            "bias_deg": before.bias_deg,
            "scale": before.scale,
            "fit_rms_deg": rms(before_deg) if before.follows else None,
            "held_out_rms_deg": rms(held_out.base_deg) if held_out and before.follows else None,
            "blocked_rms_deg": rms(worst.base_deg) if worst and before.follows else None,
        },
        "verdict": next((v for v in WEAKEST_FIRST if v in verdicts), "nothing"),
        "effects": effects,
        "final": {
            "held_out_rms_deg": None if held_out is None else rms(held_out.final_deg),
            "blocked_rms_deg": None if worst is None else rms(worst.final_deg),
            "fit_rms_deg": rms(after_deg) if findings.found else rms(before_deg),
            "model": model_words(findings),
        },
        "follow_up": None,
        "confirmed_by": None,
        "warnings": list(diagnosis.warnings),
    }


def _how(r: Responses, held_out: CrossValidation, blocks: Sequence[Blocked]) -> str:
    """Return how the errors on held-out poses were measured, in words."""
    things = {TIME: "time" if r.time_s is not None else "the rows"}
    along = " and ".join(f"along {things.get(one.along, one.along)}" for one in blocks)
    those = "" if held_out.is_searched else ", with the effects of all poses"
    return f"{held_out.folds} folds, interleaved{those}; {BLOCKS} contiguous blocks {along}"


def _noise(lack: LackOfFit) -> dict[str, Any]:
    """Return the residual's noise, and the pure error that it is compared with."""
    tested = {"f": lack.f, "freedom": list(lack.freedom), "p_value": lack.p_value, "rejected": lack.rejects}
    return {
        "std_deg": lack.residual.std_deg,
        "lag1_correlation": lack.lag1_correlation,
        "floor_deg": None if lack.dwell is None else lack.dwell.std_deg,
        "repeat_deg": None if lack.repeat is None else lack.repeat.std_deg,
        "pure_error_deg": None if lack.pure is None else lack.pure.std_deg,
        "lack_of_fit": None if lack.f is None else tested,
    }


def _before(r: Responses) -> tuple[Line, FloatArray]:
    """Return bias and scale alone, and (n,) what they leave of the readings, in degrees of elevation."""
    reading_deg = r.theta_deg + r.values[:, 0]
    line = fit_line(r.theta_deg, reading_deg)
    return line, line.left_deg(r.theta_deg, reading_deg)


def _after_deg(findings: Findings) -> FloatArray:
    """Return (n,) what the final model leaves of the readings, in degrees of elevation."""
    accepted = [f.candidate for f in findings.found]
    return left_deg(findings.responses, accepted, findings.fitted)


def trace(
    runs: Sequence[Sequence[Pose]],
    run_ids: Sequence[str],
    *,
    request: DiagnosisRequest = AS_USUAL,
    plan: dict[str, Any] | None = None,
    limits_deg: tuple[float, float] | None = None,
    deciding: Sequence[int] | None = None,
    progress: Progress = unheard,
) -> dict[str, Any]:
    """All of CONTRACT section 5: diagnosis, the run that would separate what is ambiguous, confirmation.

    Beside it `grade` and `says`, what a person should make of it.

    The `plan` of the latest run has the settings of the follow-up; `limits_deg` are the rig's soft limits,
    else the range of the poses. Of the latest run, the poses `deciding` serve to decide; the others confirm.
    Other arguments and errors are as of `diagnose`.
    """
    used = [list(run) for run in runs]
    if deciding is not None:
        used[-1] = [used[-1][k] for k in deciding]
    diagnosis = diagnose(used, run_ids, request=request, progress=progress)
    found = document(diagnosis, run_ids)
    if deciding is not None:
        confirmation = confirm(runs[:-1], runs[-1], deciding, diagnosis.findings)
        found["confirmed_by"] = confirmation and {
            "run_id": run_ids[-1],
            "before_rms_deg": confirmation.before_rms_deg,
            "after_rms_deg": confirmation.after_rms_deg,
        }
    if ambiguous_of(diagnosis.findings) is not None:
        elevations = [pose.theta_deg for run in used for pose in run]
        designed = design(
            diagnosis.runs, diagnosis.findings, limits_deg or (min(elevations), max(elevations))
        )
        if isinstance(designed, str):
            found["warnings"].append(designed)
        else:
            found["follow_up"] = designed.document(plan or {})
    decided = None if deciding is None else len(deciding)
    return {**found, **asdict(conclude(found, decided, request.reference_std_deg))}
