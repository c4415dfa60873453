"""Poses of units clamped with any of their axes along the stage's: checked, and put into columns.

Seen along the stage's axis every such mount is one about x, its components in turn: what is refused or said
of mounts about x is refused and said of these (`mounts`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calrig.calibration.joint.clamping import FACES, face_matrix
from calrig.calibration.joint.mounts import TOLD, table_of
from calrig.calibration.joint.outliers import GROSS_G
from calrig.calibration.joint.table import Mounted, Table
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.pose_columns import complete
from calrig.estimation.angles import FloatArray, wrap_deg

MOST_POSES = 0.8
MOST_ALONG_G = 0.6
"""Of gravity along an axis that lies along the stage's: a unit of 150 mg offset, 10° askew, has 0.35."""


@dataclass(frozen=True, slots=True, eq=False)
class ThreeAxisTable:
    """n poses.

    Attributes:
        seen: the poses as of mounts about x, each mount's components in turn.
        vector_g: (n, 3) a_x, a_y, a_z of the unit.
        faces: of each mount, the axis along the stage's.
        poses: (n,) as they were measured.
        before: (n,) the pose of the mount that the stage came from; None of the first.
    """

    seen: Table
    vector_g: FloatArray
    faces: tuple[str, ...]
    poses: tuple[Pose, ...]
    before: tuple[Pose | None, ...]


def whole_units(lots: Sequence[Mounted]) -> bool:
    """Whether any unit was clamped with its y or z along the stage's axis."""
    return any(_face(lot)[-1] != "x" for lot in lots)


def three_axis_table(lots: Sequence[Mounted]) -> tuple[ThreeAxisTable, list[str]]:
    """The poses in columns, and what a person should know of how they were taken.

    Raises:
        DiagnosisError: they cannot be what they are said to be; names the file and the mount.
    """
    warnings: list[str] = []
    checked = [found for lot in lots if (found := _checked(lot, warnings)) is not None]
    if not checked:
        raise DiagnosisError(f"no pose has all of gravity's components: {'; '.join(warnings[:TOLD])}")
    own = _named_by_face(checked)
    seen, said = table_of([_about_x(lot) for lot in own])
    of_mount: dict[tuple[str, str], list[Mounted]] = defaultdict(list)
    for lot in own:
        of_mount[lot.unit, lot.mount].append(lot)
    in_order = [of_mount[seen.units[mount.unit], mount.name] for mount in seen.mounts]
    poses = tuple(pose for same in in_order for lot in same for pose in lot.poses)
    faces = tuple(_face(same[0]) for same in in_order)
    came_from = {id(now): before for lot in lots for before, now in pairwise(lot.poses)}
    before = tuple(came_from.get(id(pose)) for pose in poses)
    return ThreeAxisTable(seen, _vectors(poses), faces, poses, before), [*warnings, *said]


def _checked(lot: Mounted, warnings: list[str]) -> Mounted | None:
    """The lot with its poses that have all three components; None where none is left."""
    where = f"{lot.source}, mount {lot.mount}"
    whole = [pose for pose in lot.poses if None not in (pose.accel_x_g, pose.accel_y_g, pose.accel_z_g)]
    if len(whole) < len(lot.poses):
        n = len(lot.poses) - len(whole)
        warnings.append(f"{where}: {n} poses lack accel_x_g, accel_y_g or accel_z_g and were left out")
    runs, said = complete([whole])
    warnings += [f"{where}: {sentence}" for sentence in said]
    if not runs:
        return None
    vectors, face = _vectors(runs[0]), _face(lot)
    size_g = float(np.median(np.linalg.norm(vectors, axis=1)))
    if abs(size_g - 1.0) > GROSS_G:
        raise DiagnosisError(f"{where}: |a| is {size_g:g} g, and a unit at rest feels 1 g")
    along_g = np.quantile(np.abs(vectors), MOST_POSES, axis=0)
    if along_g["xyz".index(face[-1])] > MOST_ALONG_G:
        level = "xyz"[int(np.argmin(along_g))]
        raise DiagnosisError(
            f"{where}: mount_axis is {face}, but gravity lies along {face[-1]} in some of its poses: "
            f"along the stage's axis lies {level}, it seems"
        )
    return replace(lot, poses=runs[0], axis=face)


def _named_by_face(lots: Sequence[Mounted]) -> list[Mounted]:
    """Lots whose name stands for several faces get the face into their name."""
    faces: dict[tuple[str, str], set[str]] = defaultdict(set)
    for lot in lots:
        faces[lot.unit, lot.mount].add(_face(lot))
    return [
        replace(lot, mount=f"{lot.mount} {_face(lot)}") if len(faces[lot.unit, lot.mount]) > 1 else lot
        for lot in lots
    ]


def _face(lot: Mounted) -> str:
    face = lot.axis.strip().lower().removeprefix("+")
    if face not in FACES:
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount}: mount_axis is {lot.axis!r}, none of {', '.join(FACES)}"
        )
    return face


def _about_x(lot: Mounted) -> Mounted:
    """The lot as of a unit whose x lies along the stage's axis."""
    vectors = _vectors(lot.poses) @ face_matrix(_face(lot))
    angle = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 2]))
    poses = [
        replace(
            pose,
            reading_deg=pose.dial_deg + float(wrap_deg(angle[k] - pose.dial_deg)),
            accel_x_g=float(vectors[k, 0]),
            accel_y_g=float(vectors[k, 1]),
            accel_z_g=float(vectors[k, 2]),
        )
        for k, pose in enumerate(lot.poses)
    ]
    return replace(lot, poses=poses, axis="x")


def _vectors(poses: Sequence[Pose]) -> FloatArray:
    return np.array([(pose.accel_x_g, pose.accel_y_g, pose.accel_z_g) for pose in poses], dtype=np.float64)
