"""A unit's calibration by a joint solution as a draft: CONTRACT sections 6 and 8."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from calrig.analysis.calibration_in_force import why_none
from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.results import gyro_of
from calrig.analysis.solutions import usable_map
from calrig.analysis.stored_runs import stored_run
from calrig.calibration.poses import MOUNT_DEG, Pose, of_first_mount
from calrig.calibration.regression import ApplyError
from calrig.calibration.results import FittedResult, apply_calibration, own_effect
from calrig.calibration.separation import with_map
from calrig.calibration.uncertainty import limit_for, make_verdict, reference_figures
from calrig.estimation.angles import wrap_deg
from calrig.export.calibration_document import line_of
from calrig.model.result import Doubt, Reference
from calrig.model.verdict import Verdict
from calrig.run_ids import short_name
from calrig.store import Run, Store
from calrig.store.convert import iso_utc
from calrig.store.records import Document, StoredPose
from calrig.store.solutions import StoredSolution
from calrig.store.trail import EVERY_ENTRY, What


def solved_run(store: Store, unit: str, solution: StoredSolution) -> Run:
    """The run that a draft by a solution is of: of the unit's, the one clamped nearest to 0°, else the last.

    Raises:
        Unknown: the solution has no such unit.
        Conflict: it does not part the unit from the stage, none of the unit's runs is about its x axis, or
            what the solution rests on has changed since.
    """
    if unit not in solution.found.calibrations:
        raise Unknown(f"solution {solution.id} has no unit {unit!r}")
    usable_map(solution)
    runs = [stored_run(store, run_id) for run_id in solution.found.basis.runs]
    if changed := solution_changes(store, solution):
        raise Conflict(f"{' '.join(changed)} Solve again, and draft that solution.")
    own = [run for run in runs if run.unit == unit and why_none(run) is None]
    if not own:
        raise Conflict(f"no run of solution {solution.id} has the x axis of unit {unit!r} along the stage's")
    return min(reversed(own), key=lambda run: abs(wrap_deg(_clamped_deg(store, run))))


def solution_changes(store: Store, solution: StoredSolution) -> list[str]:
    """What a solution rests on that has changed since it was found, a sentence each."""
    basis = solution.found.basis
    what: tuple[What, ...] = ("excluded", "included", "moved")
    entries = store.trail.entries(what=what, since=solution.created_at, limit=EVERY_ENTRY)
    voided = [run for run in (stored_run(store, run_id) for run_id in basis.runs) if run.voided is not None]
    said = [gone for run in voided if (gone := gone_since(run, run.unit)) is not None]
    for done, words in (
        (("moved",), "was moved to another unit"),
        (("excluded", "included"), "had poses excluded or included"),
    ):
        changed = {str(one.run_id) for one in entries if one.what in done} & set(basis.runs)
        said += [f"Run {run_id} {words} since it was solved." for run_id in sorted(changed)]
    return said


def gone_since(run: Run, unit: str) -> str | None:
    """That a run counts no more for a unit, whose calibration rests on it; None where it does."""
    if run.voided is not None:
        return f"Run {run.id}, which it rests on, has been voided: {run.voided.reason}"
    return None if run.unit == unit else f"Run {run.id}, which it rests on, is of unit {run.unit} now."


def solved_poses(solution: StoredSolution, run: Run, poses: Sequence[StoredPose]) -> list[StoredPose]:
    """A run's poses as a solution has them: at the angle found for the mount, the stage put right by its map.

    Those at other mounts than the first one's keep the angle that was stated.
    """
    if not poses:
        return []
    first = _stated_deg(run, poses[0].pose)
    found_deg = _found_deg(solution, run, first)
    placed = [
        replace(one.pose, covariates={**one.pose.covariates, MOUNT_DEG: found_deg})
        if _stated_deg(run, one.pose) == first
        else one.pose
        for one in poses
    ]
    mapped = with_map(placed, usable_map(solution))
    return [replace(one, pose=pose) for one, pose in zip(poses, mapped, strict=True)]


def solved_content(store: Store, unit: str, solution: StoredSolution) -> Document:
    """CONTRACT section 6 by the solution; its provenance says which, and goes beside the run's."""
    document = solution.found.calibrations[unit]
    runs = [stored_run(store, run_id) for run_id in solution.found.basis.runs]
    own = [run for run in runs if run.unit == unit]
    stated = next(one for one in solution.found.document["units"] if one["unit"] == unit)
    warnings = [said for run in own for said in run.provenance.get("warnings", ())]
    warnings += [f"Joint solution: {said}." for said in solution.found.document["warnings"]]
    provenance = {
        **document["provenance"],
        "warnings": list(dict.fromkeys(warnings)),
        "solution": {
            "id": solution.id,
            "solved_at": iso_utc(solution.created_at),
            "sha256": document["sha256"],
            "map_sha256": solution.found.stage_map["sha256"],
            "runs": [run.id for run in runs],
            "began_at": _iso(min((r.started_at for r in own if r.started_at), default=None)),
            "std": {name: value["std"] for name, value in stated["parameters"].items()},
            "ended_at": _iso(max((r.finished_at for r in own if r.finished_at), default=None)),
        },
    }
    uncertainty = {"reference_bias_deg": None, "reference_scale": None, **document["uncertainty"]}
    return {**document, "uncertainty": uncertainty, "provenance": provenance}


def solved_verdict(
    store: Store,
    content: Document,
    run: Run,
    solution: StoredSolution,
    poses: Sequence[StoredPose],
    doubts: Sequence[Doubt],
) -> Verdict:
    """Test a solution against the limits, by the residuals of its run's poses.

    What the solution is uncertain of is one smooth curve over the range; a limit's risk takes of it the line
    whose covariance the document has.
    """
    counted = [one.pose for one in solved_poses(solution, run, poses) if one.excluded is None]
    line = line_of(content)
    nothing = ((0.0, 0.0), (0.0, 0.0))
    known = Reference(content["uncertainty"]["type_b_deg"], "map", "normal", nothing)
    theta_deg = np.array([pose.theta_deg for pose in of_first_mount(counted)], dtype=np.float64)
    effects = [own_effect(one["name"], one["parameters"]) for one in content["effects"]]
    try:
        result = apply_calibration(
            counted, gyro_of(run), line, effects, reference_figures(theta_deg, line, known)
        )
    except ApplyError as error:
        raise Conflict(f"run {run.id}: {error}") from error
    return make_verdict(
        _as_one_calibration(result).with_doubts(doubts),
        limit=limit_for(store.limits.all(), content["unit"], content["rig"]),
        calibration=content,
    )


def _as_one_calibration(result: FittedResult) -> FittedResult:
    """Return a result whose bias and scale mean nothing without the effects: 0 and 1, not fitted."""
    return result.model_copy(
        update={
            "rms_calibrated_deg": result.rms_with_effects_deg,
            "rms_with_effects_deg": None,
            "scale_std": None,
            "over_range": None if result.over_range is None else replace(result.over_range, covariance=None),
        }
    )


def _clamped_deg(store: Store, run: Run) -> float:
    first = next(iter(store.poses.of(run.id)), None)
    return 0.0 if first is None else _stated_deg(run, first.pose)


def _stated_deg(run: Run, pose: Pose) -> float:
    """The angle at which a pose's unit was said to be clamped, as the solution took it."""
    own, planned = pose.covariates.get(MOUNT_DEG), (run.plan or {}).get("mounts_deg") or [0.0]
    return float(planned[0] if len(planned) == 1 else 0.0) if own is None else float(own)


def _found_deg(solution: StoredSolution, run: Run, stated_deg: float) -> float:
    """The angle that a solution found for a mount of a run."""
    names = {f"{name} {stated_deg:g}°" for name in (run.id, short_name(run.id))}
    for mount in solution.found.document["mounts"]:
        if mount["mount"] in names and mount["unit"] in solution.found.basis.units:
            return float(mount["angle_deg"]["value"])
    raise Conflict(f"solution {solution.id} has no mount of run {run.id} at {stated_deg:g}°")


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else iso_utc(moment)
