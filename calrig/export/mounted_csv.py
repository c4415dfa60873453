"""Poses of several clampings and units in one file (CONTRACT section 4: `unit`, `mount`, `mount_deg`, …)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calrig.calibration.joint.table import Mounted
from calrig.calibration.pose import Pose
from calrig.export.cells import CsvError
from calrig.export.poses_csv import Labels, read_labelled_poses

LABELS = ("unit", "mount", "mount_axis")
MOUNT_DEG = "mount_deg"


def read_mounted(data: bytes, source: str, unit: str | None = None) -> tuple[list[Mounted], list[str]]:
    """The poses of a file, a lot for each clamping.

    Args:
        data: the file.
        source: what it is called.
        unit: serial number of its poses, where it has no column `unit`.

    Raises:
        CsvError: the file is no table of poses, or does not say of every pose whose it is.
    """
    poses, labels, warnings = read_labelled_poses(data, LABELS)
    return lots_of(poses, labels, source, unit), warnings


def lots_of(
    poses: Sequence[Pose], labels: Sequence[Labels], source: str, unit: str | None = None
) -> list[Mounted]:
    """Poses of one file or run by their clamping, in the order measured.

    Without a label a mount is called by its source, and its angle where there is one.
    """
    lots: dict[tuple[str, str, float | None, str], list[Pose]] = {}
    for pose, texts in zip(poses, labels, strict=True):
        serial, angle = texts.get("unit", unit), pose.covariates.get(MOUNT_DEG)
        if serial is None:
            whose = (
                f"the pose at target_deg {pose.target_deg:g} has no unit"
                if lots
                else "it is not said whose poses these are"
            )
            raise CsvError(f"{whose}: give it a column unit, or --unit", column="unit")
        axis = texts.get("mount_axis", "x")
        name = texts.get("mount") or _name(source, angle, axis)
        bare = replace(pose, covariates={k: v for k, v in pose.covariates.items() if k != MOUNT_DEG})
        lots.setdefault((serial, name, angle, axis), []).append(bare)
    return [
        Mounted(serial, name, angle, source, own, axis) for (serial, name, angle, axis), own in lots.items()
    ]


def _name(source: str, angle: float | None, axis: str) -> str:
    """Of a mount without a label."""
    words = [source, "" if angle is None else f"{angle:g}°", "" if axis.lstrip("+") == "x" else axis]
    return " ".join(word for word in words if word)
