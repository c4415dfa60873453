"""What a follow-up rests on: runs whose diagnosis left indistinguishable suspects."""

from __future__ import annotations

from dataclasses import dataclass

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import counted_poses, runs_together
from calrig.calibration.diagnosis import diagnose
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.search import Findings
from calrig.store import Run, Store


@dataclass(frozen=True, slots=True)
class Unresolved:
    """Runs of one unit in the order measured, the poses of each that count, and what was found in them."""

    runs: list[Run]
    poses: list[list[Pose]]
    findings: Findings


def unresolved(store: Store, run_id: str) -> Unresolved:
    """A run with those it follows on, diagnosed quickly: without errors on held-out poses.

    Raises:
        Unknown: there is no such run.
        Conflict: one of them has not ended, or its poses cannot be diagnosed; says why.
    """
    runs = runs_together(store, run_id)
    poses = [counted_poses(store, run.id) for run in runs]
    try:
        findings = diagnose(poses, cross_fit=False).findings
    except DiagnosisError as error:
        raise Conflict(f"run {run_id}: {error}") from error
    return Unresolved(runs, poses, findings)
