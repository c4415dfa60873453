"""Poses of several clampings and units in one file (CONTRACT section 4: `unit`, `mount`, `mount_deg`, …)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from calrig.calibration.poses import MOUNT_DEG, Pose
from calrig.calibration.separation import FACES, MountedPoses
from calrig.export.cells import CsvError
from calrig.export.poses_csv import (
    Labels,
    PoseColumns,
    Texts,
    read_labelled_columns,
    read_labelled_poses,
)

AXIS = "mount_axis"
LABELS = ("unit", "mount", AXIS)


def read_run(
    data: bytes, unit: str, progress: Callable[[float], None] | None = None
) -> tuple[PoseColumns, str, list[str]]:
    """The poses of a file that is to be a run, in the order measured, and how they are clamped.

    A run is of one unit, has one of its axes along the stage's, and one clamping at each angle.

    Args:
        data: the file.
        unit: serial number of the run's unit.
        progress: told the share of the file that is read, 0 to 1.

    Returns:
        The poses, the axis along the stage's, and what is to be said.

    Raises:
        CsvError: the file is no table of poses, or they are of several runs.
    """
    poses, texts, warnings = read_labelled_columns(data, LABELS, progress)
    if "unit" in texts and (serial := _one(texts["unit"], "unit")) not in {unit, ""}:
        warnings.append(f"the file says that these poses are of unit {serial}")
    axis = _axis(texts[AXIS]) if AXIS in texts else "x"
    if "mount" in texts:
        _refuse_two_in_one(texts["mount"], poses.cells(MOUNT_DEG))
    ordered, of_time = poses.in_time()
    return ordered, axis, [*warnings, *([of_time] if of_time else [])]


def read_about_x(data: bytes) -> tuple[list[Pose], list[str]]:
    """The poses of a file that are one unit's, about its x, in the order measured, and what is to be said.

    Raises:
        CsvError: the file is no table of poses, or they are of several units or about another axis.
    """
    poses, texts, warnings = read_labelled_columns(data, ("unit", AXIS))
    if "unit" in texts:
        _one(texts["unit"], "unit")
    axis = _axis(texts[AXIS]) if AXIS in texts else "x"
    if axis != "x":
        raise CsvError(f"is {axis}, and this is of elevations about x; `calrig solve` takes it", column=AXIS)
    ordered, of_time = poses.in_time()
    return ordered[:], [*warnings, *([of_time] if of_time else [])]


def _one(column: Texts, name: str) -> str:
    """The text of every cell; blank cells are of any."""
    first = next((text for text in column.texts if text), "")
    for text, line in zip(column.texts, column.lines, strict=True):
        if text not in {first, ""}:
            raise CsvError(f"{text!r} after {first!r}: {_ALONE}", line=line, column=name)
    return first


_ALONE = "make a file of each, and a run of each file, or solve the file as it is"


def _axis(column: Texts) -> str:
    """What every pose has along the stage's axis; `x` where a cell is blank."""
    faces = [text.lower().removeprefix("+") or "x" for text in column.texts]
    for text, face, line in zip(column.texts, faces, column.lines, strict=True):
        if face not in FACES:
            raise CsvError(f"{text!r} is none of {', '.join(FACES)}", line=line, column=AXIS)
    return _one(Texts(faces, column.lines), AXIS) or "x"


def _refuse_two_in_one(mounts: Texts, angles: Sequence[float | None] | None) -> None:
    """Raises CsvError where one label is at two angles, or two are at one: a run tells them by the angle."""
    at: dict[str, float | None] = {}
    named: dict[float | None, str] = {}
    for place, (mount, line) in enumerate(zip(mounts.texts, mounts.lines, strict=True)):
        if not mount:
            continue
        angle = None if angles is None else angles[place]
        if at.setdefault(mount, angle) != angle:
            said = f"{mount!r} was clamped at {_degrees(at[mount])} and at {_degrees(angle)}"
            raise CsvError(f"{said}: give what was clamped anew a name of its own", line=line, column="mount")
        if (other := named.setdefault(angle, mount)) != mount:
            said = f"{mount!r} and {other!r} are two clampings at {_degrees(angle)}"
            raise CsvError(f"{said}: {_ALONE}", line=line, column="mount")


def _degrees(angle: float | None) -> str:
    return "no stated angle" if angle is None else f"{angle:g}°"


def read_mounted(data: bytes, source: str, unit: str | None = None) -> tuple[list[MountedPoses], list[str]]:
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
) -> list[MountedPoses]:
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
        axis = texts.get(AXIS, "x")
        name = texts.get("mount") or _name(source, angle, axis)
        bare = replace(pose, covariates={k: v for k, v in pose.covariates.items() if k != MOUNT_DEG})
        lots.setdefault((serial, name, angle, axis), []).append(bare)
    return [
        MountedPoses(serial, name, angle, source, own, axis)
        for (serial, name, angle, axis), own in lots.items()
    ]


def _name(source: str, angle: float | None, axis: str) -> str:
    """Of a mount without a label."""
    words = [source, "" if angle is None else f"{angle:g}°", "" if axis.lstrip("+") == "x" else axis]
    return " ".join(word for word in words if word)
