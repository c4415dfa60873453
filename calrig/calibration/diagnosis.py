"""The diagnosis: what is left after bias and scale, traced to an effect, with the error before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calrig.calibration.candidates import candidates_of
from calrig.calibration.cross_validation import CrossValidation, confirm, cross_validate
from calrig.calibration.diagnosis_verdict import diagnosis_verdict
from calrig.calibration.experiment_design import ambiguous_of, design
from calrig.calibration.fit import fit_line, residuals_deg, rms
from calrig.calibration.pose import Pose
from calrig.calibration.pose_columns import complete
from calrig.calibration.report import effect_documents, model_words
from calrig.calibration.responses import SCALE_UNIT_DEG, Responses, responses_of
from calrig.calibration.search import Findings, search
from calrig.estimation.angles import FloatArray

BOOTSTRAPS = 999
WEAKEST_FIRST = ("ambiguous", "unnamed", "named")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found in some poses, before it is put into words.

    Attributes:
        runs: the poses it rests on: those that are complete, less outliers.
        findings: the effects, and the fit of the final model.
        held_out: errors on held-out poses, before and after; None where they were not asked for.
        warnings: what was left out or looked odd.
    """

    runs: tuple[tuple[Pose, ...], ...]
    findings: Findings
    held_out: CrossValidation | None
    floor_deg: float | None
    warnings: tuple[str, ...]


def diagnose(
    runs: Sequence[Sequence[Pose]],
    run_ids: Sequence[str] | None = None,
    *,
    seed: int = 0,
    bootstraps: int = BOOTSTRAPS,
    cross_fit: bool = True,
) -> Diagnosis:
    """Traces what bias and scale leave of the poses to the effects the model lacks.

    Args:
        runs: the poses of one or several runs of a unit, in the order measured, none excluded.
        run_ids: what the runs are called, for what changed between two of them; else counted from 0.
        seed: of the bootstrap: the same poses and seed give the same diagnosis.
        bootstraps: of each step of the search.
        cross_fit: whether the errors before and after are measured on held-out poses.

    Raises:
        DiagnosisError: the poses cannot be diagnosed; the message says why.
    """
    whole, incomplete = complete(runs)
    r = responses_of(runs, run_ids)
    candidates = candidates_of(r)
    rng = np.random.default_rng(seed)
    findings = search(r, candidates, rng, bootstraps=bootstraps)
    kept, outliers = _parted(whole, findings)
    held_out = None
    if cross_fit:
        held_out = cross_validate(findings.responses, [c.rows(findings.kept) for c in candidates], rng)
    errors = [e for run in kept for pose in run if (e := pose.reading_stderr_deg) is not None]
    floor = math.sqrt(sum(e * e for e in errors) / len(errors)) if errors else None
    return Diagnosis(kept, findings, held_out, floor, (*outliers, *incomplete, *r.warnings))


def _parted(
    runs: Sequence[Sequence[Pose]], findings: Findings
) -> tuple[tuple[tuple[Pose, ...], ...], list[str]]:
    """The runs less the outliers of a search, and a sentence for each of those."""
    used = set(findings.kept.tolist())
    kept, said, first = [], [], 0
    for number, run in enumerate(runs):
        where = f" of run {number}" if len(runs) > 1 else ""
        kept.append(tuple(pose for k, pose in enumerate(run, first) if k in used))
        said += [
            f"outlier: pose {k - first}{where} at {pose.target_deg:g}° reads {pose.reading_deg:g}°, far from "
            "what the model says of it: left out"
            for k, pose in enumerate(run, first)
            if k not in used
        ]
        first += len(run)
    return tuple(kept), said


def document(diagnosis: Diagnosis, run_ids: Sequence[str]) -> dict[str, Any]:
    """The diagnosis as CONTRACT section 5 has it, without follow-up and confirmation."""
    findings = diagnosis.findings
    r = findings.responses
    before = fit_line(r.theta_deg, r.theta_deg + r.values[:, 0])
    before_deg = residuals_deg(r.theta_deg, r.theta_deg + r.values[:, 0], before.bias_deg, before.scale)
    after_deg = findings.fitted.residuals[:, 0] / _scale(r, findings)
    effects = effect_documents(r, findings)
    verdicts = [effect["verdict"] for effect in effects]
    held_out = diagnosis.held_out
    return {
        "runs": list(run_ids),
        "n_poses": len(r),
        "held_out": {
            "how": "not measured" if held_out is None else f"{held_out.folds} folds",
            "n_poses": 0 if held_out is None else len(r),
        },
        "noise": {
            "std_deg": _unbiased_std(findings),
            "lag1_correlation": _lag1(after_deg, float(r.rounding[0])),
            "floor_deg": diagnosis.floor_deg,
        },
        "base": {
            "bias_deg": before.bias_deg,
            "scale": before.scale,
            "fit_rms_deg": rms(before_deg),
            "held_out_rms_deg": None if held_out is None else rms(held_out.base_deg),
        },
        "verdict": next((v for v in WEAKEST_FIRST if v in verdicts), "nothing"),
        "effects": effects,
        "final": {
            "held_out_rms_deg": None if held_out is None else rms(held_out.final_deg),
            "fit_rms_deg": rms(after_deg) if findings.found else rms(before_deg),
            "model": model_words(findings),
        },
        "follow_up": None,
        "confirmed_by": None,
        "warnings": list(diagnosis.warnings),
    }


def _scale(r: Responses, findings: Findings) -> float:
    names = r.base_names
    if "reading.scale" not in names:
        return 1.0
    return 1.0 + float(findings.fitted.beta[names.index("reading.scale")]) / SCALE_UNIT_DEG


def _unbiased_std(findings: Findings) -> float:
    residuals = findings.fitted.residuals[:, 0]
    channels = findings.fitted.residuals.shape[1]
    freedom = max(len(residuals) - findings.columns.shape[2] / channels, 1.0)
    return math.sqrt(float(residuals @ residuals) / freedom)


def _lag1(residual: FloatArray, rounding_deg: float) -> float:
    power = float(residual @ residual) + len(residual) * rounding_deg**2
    return float(residual[1:] @ residual[:-1]) / power


def trace(
    runs: Sequence[Sequence[Pose]],
    run_ids: Sequence[str],
    *,
    plan: dict[str, Any] | None = None,
    limits_deg: tuple[float, float] | None = None,
    deciding: Sequence[int] | None = None,
) -> dict[str, Any]:
    """All of CONTRACT section 5: diagnosis, the run that would separate what is ambiguous, confirmation.

    Beside it `grade` and `says`, what a person should make of it.

    Args:
        runs: the poses of one or several runs of a unit.
        run_ids: their ids, in the same order.
        plan: of the latest run, for the follow-up to keep its settings.
        limits_deg: soft limits of the rig; the range of the poses where there is none.
        deciding: of the latest run, the poses that serve to decide; the others confirm.

    Raises:
        DiagnosisError: the poses cannot be diagnosed; the message says why.
    """
    used = [list(run) for run in runs]
    if deciding is not None:
        used[-1] = [used[-1][k] for k in deciding]
    diagnosis = diagnose(used, run_ids)
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
    return {**found, **asdict(diagnosis_verdict(found, decided))}
