"""How the unit of a stored run was clamped: what its poses' columns `mount` and `mount_axis` say."""

from __future__ import annotations

from collections.abc import Callable

from calrig.calibration.pose import Pose
from calrig.export.poses_csv import Labels
from calrig.store import Run


def axis_of(run: Run) -> str:
    """Which of the unit's axes lay along the stage's."""
    return str((run.plan or {}).get("mount_axis", "x"))


def mount_name(run: Run, pose: Pose) -> str | None:
    """What a pose shares with those that were taken without the unit being touched; None of imported ones."""
    return None if run.plan is None else f"{run.id} {pose.mount_deg:g}°"


def labels_of(run: Run) -> Callable[[Pose], Labels] | None:
    """What a table of a run's poses says of each in words; None where nothing was asked of mounts."""
    plan, axis = run.plan or {}, axis_of(run)
    if plan.get("mounts_deg", [0.0]) == [0.0] and axis == "x":
        return None
    return lambda pose: {"mount": mount_name(run, pose) or "", "mount_axis": axis}
