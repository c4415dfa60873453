"""The partial residuals of a stored diagnosis, for drawing."""

from __future__ import annotations

from calrig.analysis.diagnoses import deciding_poses
from calrig.analysis.errors import Conflict, Unknown
from calrig.calibration.partial_residuals import Traced, partial_residuals
from calrig.calibration.pose import Pose
from calrig.calibration.responses import DiagnosisError
from calrig.store import Run, Store


def traced_effects(store: Store, run: Run) -> list[Traced]:
    """Each effect of a run's last diagnosis in the poses it rests on, those of them that still count.

    Raises:
        Unknown: the run has not been diagnosed.
        Conflict: what counts now cannot show an effect any more; says what to do.
    """
    found = run.diagnosis
    if found is None:
        raise Unknown(f"run {run.id} has not been diagnosed")
    runs = [_poses(store, run_id, None) for run_id in found["runs"][:-1]]
    runs.append(_poses(store, run.id, deciding_poses(run) if runs else None))
    try:
        return partial_residuals(runs, found["effects"])
    except DiagnosisError as error:
        raise Conflict(f"run {run.id}: {error}") from error


def _poses(store: Store, run_id: str, deciding: list[int] | None) -> list[Pose]:
    """The poses of a run that count; of a follow-up those that served to decide."""
    stored = store.poses(run_id, include_excluded=False)
    return [s.pose for s in stored if deciding is None or s.index in deciding]
