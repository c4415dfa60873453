"""How a unit sits on the stage: gravity's direction in its frame, by dial, mount and the stage's level.

In the stage's frame, x along its axis, the vertical is (sin τ, 0, cos τ): of an axis that is not level no
more can be seen than its dip τ. The table turns it about x by φ = dial + map + mount; the clamping then has
one of the unit's axes along the stage's, but for two small tilts about the other two.

Poses of units clamped with any of their axes along the stage's: checked, and put into columns.

Seen along the stage's axis every such mount is one about x, its components in turn: what is refused or said
of mounts about x is refused and said of these (`mounts`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calrig.calibration.poses import DiagnosisError, Pose, complete
from calrig.calibration.separation.mounts import GROSS_G, TOLD, table_of
from calrig.calibration.separation.pose_table import MountedPoses, Table
from calrig.estimation.angles import FloatArray, wrap_deg

FACES = tuple(sign + axis for axis in "xyz" for sign in ("", "-"))
"""What `mount_axis` may be."""


def face_matrix(face: str) -> FloatArray:
    """(3, 3) rotation from a frame whose x lies along the stage's axis to the unit's.

    The unit's other axes follow in turn: with y along the stage's axis, elevation is atan2(a_z, a_x). With a
    minus the unit is turned by half a turn about the third, so that its elevation changes sign.
    """
    first = "xyz".index(face[-1])
    sign = -1.0 if face.startswith("-") else 1.0
    matrix = np.zeros((3, 3))
    for column, size in enumerate((sign, sign, 1.0)):
        matrix[(first + column) % 3, column] = size
    return matrix


def tilted(tilts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3, 3) rotation about y, then z, by two angles (2,); and (2, 3, 3) its derivatives."""
    (about_y, by_y), (about_z, by_z) = (_turn(axis, angle) for axis, angle in zip((1, 2), tilts, strict=True))
    return about_y @ about_z, np.stack([by_y @ about_z, about_y @ by_z])


def stage_direction(turn: FloatArray, dip: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The vertical as the table has it, (n, 3), and its derivatives by the turn and by the dip.

    Args:
        turn: (n,) φ, rad.
        dip: of the stage's axis out of level, rad.
    """
    s, c = np.sin(turn), np.cos(turn)
    nil, one = np.zeros_like(s), np.ones_like(s)
    across, along = np.cos(dip), np.sin(dip)
    return (
        np.stack([along * one, across * s, across * c], axis=1),
        np.stack([nil, across * c, -across * s], axis=1),
        np.stack([across * one, -along * s, -along * c], axis=1),
    )


def _turn(axis: int, angle: float) -> tuple[FloatArray, FloatArray]:
    s, c = np.sin(angle), np.cos(angle)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix, slope = np.eye(3), np.zeros((3, 3))
    matrix[one, one] = matrix[other, other] = c
    slope[one, one] = slope[other, other] = -s
    matrix[one, other], matrix[other, one] = -s, s
    slope[one, other], slope[other, one] = -c, c
    return matrix, slope


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


def whole_units(lots: Sequence[MountedPoses]) -> bool:
    """Whether any unit was clamped with its y or z along the stage's axis."""
    return any(_face(lot)[-1] != "x" for lot in lots)


def three_axis_table(lots: Sequence[MountedPoses]) -> tuple[ThreeAxisTable, list[str]]:
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
    of_mount: dict[tuple[str, str], list[MountedPoses]] = defaultdict(list)
    for lot in own:
        of_mount[lot.unit, lot.mount].append(lot)
    in_order = [of_mount[seen.units[mount.unit], mount.name] for mount in seen.mounts]
    poses = tuple(pose for same in in_order for lot in same for pose in lot.poses)
    faces = tuple(_face(same[0]) for same in in_order)
    came_from = {id(now): before for lot in lots for before, now in pairwise(lot.poses)}
    before = tuple(came_from.get(id(pose)) for pose in poses)
    return ThreeAxisTable(seen, _vectors(poses), faces, poses, before), [*warnings, *said]


def _checked(lot: MountedPoses, warnings: list[str]) -> MountedPoses | None:
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


def _named_by_face(lots: Sequence[MountedPoses]) -> list[MountedPoses]:
    """Lots whose name stands for several faces get the face into their name."""
    faces: dict[tuple[str, str], set[str]] = defaultdict(set)
    for lot in lots:
        faces[lot.unit, lot.mount].add(_face(lot))
    return [
        replace(lot, mount=f"{lot.mount} {_face(lot)}") if len(faces[lot.unit, lot.mount]) > 1 else lot
        for lot in lots
    ]


def _face(lot: MountedPoses) -> str:
    face = lot.axis.strip().lower().removeprefix("+")
    if face not in FACES:
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount}: mount_axis is {lot.axis!r}, none of {', '.join(FACES)}"
        )
    return face


def _about_x(lot: MountedPoses) -> MountedPoses:
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
