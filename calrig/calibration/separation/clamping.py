"""How a unit sits on the stage: gravity's direction in its frame, by dial, clamping and the stage's level.

In the stage's frame, x along its axis, the vertical is (sin τ, 0, cos τ): of an axis that is not level no
more can be seen than its dip τ. The table turns it about x by φ = dial + map + mount; the clamping then has
one of the unit's axes along the stage's, but for two small tilts about the other two.
"""

import numpy as np

from calrig.estimation.angles import FloatArray

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
    """The vertical as the table has it, (n, 3), and its derivatives by the turn φ (n,) and the dip, rad.

    The dip is of the stage's axis out of level.
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
