"""What a follow-up rests on: runs whose diagnosis left indistinguishable suspects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import poses_together, runs_together
from calrig.calibration.diagnosis import diagnose
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.search import Findings
from calrig.processes.pool import Apart, run_apart
from calrig.store import Run, Store


@dataclass(frozen=True, slots=True)
class Unresolved:
    """Runs of one unit in the order measured, the poses of each that count, and what was found in them."""

    runs: list[Run]
    poses: list[list[Pose]]
    findings: Findings


def unresolved(store: Store, run_id: str, apart: Apart = run_apart) -> Unresolved:
    """A run with those it follows on, diagnosed quickly: without errors on held-out poses.

    Args:
        store: has them.
        run_id: the run.
        apart: carries the diagnosis out in another process.

    Raises:
        Unknown: there is no such run.
        Conflict: one of them has not ended, or its poses cannot be diagnosed; says why.
        Invalid: they are too many.
    """
    runs = runs_together(store, run_id)
    poses = poses_together(store, runs)
    try:
        findings = apart(partial(_found, poses))
    except DiagnosisError as error:
        raise Conflict(f"run {run_id}: {error}") from error
    return Unresolved(runs, poses, findings)


def _found(poses: list[list[Pose]]) -> Findings:
    return diagnose(poses, cross_fit=False).findings
