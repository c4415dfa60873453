"""Stored runs of one rig as the joint solution takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import counted_poses, ended_run
from calrig.calibration.joint.table import Mounted
from calrig.calibration.pose import MOUNT_DEG, Pose
from calrig.store import Run, Store


def mounted_runs(store: Store, run_ids: Sequence[str]) -> list[Mounted]:
    """The poses of runs that count, a lot for each clamping.

    Raises:
        Unknown: there is no such run.
        Conflict: a run has not ended, or is of another rig: each has a map of its own.
    """
    runs = [ended_run(store, run_id) for run_id in dict.fromkeys(run_ids)]
    for run in runs:
        if run.rig != runs[0].rig:
            raise Conflict(
                f"run {run.id} is of rig {run.rig!r}, run {runs[0].id} of rig {runs[0].rig!r}: each stage "
                "has a map of its own, solve them one by one"
            )
    return [lot for run in runs for lot in _lots(run, counted_poses(store, run.id))]


def _lots(run: Run, poses: Sequence[Pose]) -> list[Mounted]:
    """One for each angle: as its poses have it, else as its plan of one mount does."""
    plan = run.plan or {}
    planned = plan.get("mounts_deg") or [0.0]
    lots: dict[float | None, list[Pose]] = {}
    for pose in poses:
        own = pose.covariates.get(MOUNT_DEG)
        bare = replace(pose, covariates={k: v for k, v in pose.covariates.items() if k != MOUNT_DEG})
        lots.setdefault(float(planned[0]) if own is None and len(planned) == 1 else own, []).append(bare)
    axis = str(plan.get("mount_axis", "x"))
    return [
        Mounted(run.unit, f"{run.id} {angle or 0.0:g}°", angle, run.id, own, axis)
        for angle, own in lots.items()
    ]
