"""How the unit of a stored run was clamped: what its poses' columns `mount` and `mount_axis` say."""

from __future__ import annotations

from collections.abc import Callable

from calrig.calibration.poses import MOUNT_DEG, Pose
from calrig.export.poses_csv import Labels
from calrig.store import Run


def axis_of(run: Run) -> str:
    """Which of the unit's axes lay along the stage's: as it was planned, or an imported file says."""
    return str((run.plan or run.provenance).get("mount_axis", "x"))


def mount_columns(run_id: str, axis: str, pose: Pose) -> dict[str, str | float]:
    """How the unit was clamped for a pose; `mount` is what it shares with those of the same clamping."""
    return {"mount": f"{run_id} {pose.mount_deg:g}°", MOUNT_DEG: pose.mount_deg, "mount_axis": axis}


def labels_of(run: Run) -> Callable[[Pose], Labels] | None:
    """What a table of a run's poses says of each in words; None where nothing was asked of mounts."""
    plan, axis = run.plan or {}, axis_of(run)
    if plan.get("mounts_deg", [0.0]) == [0.0] and axis == "x":
        return None

    def labels(pose: Pose) -> Labels:
        columns = mount_columns(run.id, axis, pose)
        return {name: str(columns[name]) for name in ("mount", "mount_axis")}

    return labels
