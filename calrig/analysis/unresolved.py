"""What a follow-up rests on: runs whose diagnosis left indistinguishable suspects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import poses_together, runs_together
from calrig.calibration.diagnosis import Findings, diagnose
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.processes.pool import run_apart

if TYPE_CHECKING:
    from calrig.store import Store


@dataclass(frozen=True, slots=True)
class Unresolved:
    """Runs of one unit in the order measured, the poses of each that count, and what was found in them."""

    run_ids: list[str]
    poses: list[list[Pose]]
    findings: Findings

    @classmethod
    def of(cls, run_ids: list[str], poses: list[list[Pose]]) -> Unresolved:
        """Runs whose poses are diagnosed quickly: without errors on held-out poses; as `unresolved`."""
        try:
            return cls(run_ids, poses, run_apart(partial(found_in, poses)))
        except DiagnosisError as error:
            raise Conflict(f"run {run_ids[-1]}: {error}") from error


def unresolved(store: Store, run_id: str) -> Unresolved:
    """A run with those it follows on, diagnosed quickly.

    Args:
        store: has them.
        run_id: the run.

    Raises:
        Unknown: there is no such run.
        Conflict: one of them has not ended, or its poses cannot be diagnosed; says why.
        Invalid: they are too many.
    """
    runs = runs_together(store, run_id)
    return Unresolved.of([run.id for run in runs], poses_together(store, runs))


def found_in(poses: list[list[Pose]]) -> Findings:
    """What a quick diagnosis of them finds; or DiagnosisError."""
    return diagnose(poses, cross_fit=False).findings
