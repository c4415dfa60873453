"""Poses of any number of mounts and units in columns; what overlaps, wraps or comes twice is refused.

A unit that was only ever clamped with its x along the stage's axis is solved for in the plane across it.
Where any unit was clamped with its y or z there, all are whole units, with all three components of gravity.
Seen along the stage's axis every mount is one about x, its components in turn: what is refused or reported of
mounts about x is refused and reported of these.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np

from calrig.calibration.poses import MOUNT_DEG, DiagnosisError, Pose, complete, refuse_what_is_no_elevation
from calrig.calibration.regression.motion import approach_of, has_history
from calrig.calibration.regression.terms import LEAST_TEMPERATURE_RANGE_C
from calrig.calibration.separation.clamping import FACES, face_matrix
from calrig.estimation.angles import BoolArray, FloatArray, Intp, wrap_deg

FEWEST_POSES = 8
FEWEST_OF_A_MOUNT = 2
SAME_DEG = 12.0
"""Two lots of poses of one mount differ by no more: errors of 150 mg turn a vector by 9°."""
APART_DEG = 1.0
"""Of two angles of a stage at one time, what is more than how it is read."""
MOST_QUOTED = 3
"""Of the warnings, in an error."""
TOGETHER = 0.7
"""Mean resultant length of reading less dial: poses of one mount lie within some 40° of each other."""
GROSS_G = 0.5
"""A vector whose length is off by more is none of gravity."""
MOST_POSES = 0.8
MOST_ALONG_G = 0.6
"""Of gravity along an axis that lies along the stage's: a unit of 150 mg offset, 10° askew, has 0.35."""


def _sense(axis: str) -> int:
    """+1, or −1 where a unit's elevation about an axis falls as the dial's angle rises."""
    return -1 if axis.startswith("-") else 1


@dataclass(frozen=True, slots=True)
class MountedPoses:
    """Poses of one unit, taken without it being touched.

    Attributes:
        unit: serial number.
        mount: a label.
        nominal_deg: the angle at which it was clamped, as stated; None if it was not stated. Reversed, the
            unit's elevation is the dial's angle and this one, both with the other sign.
        source: the file or run they are of.
        axis: which of the unit's axes lies along the stage's.
    """

    unit: str
    mount: str
    nominal_deg: float | None
    source: str
    poses: Sequence[Pose]
    axis: str = "x"

    @classmethod
    def of_run(
        cls,
        poses: Sequence[Pose],
        *,
        unit: str,
        run_id: str,
        name: str,
        axis: str,
        planned_deg: Sequence[float],
    ) -> list[MountedPoses]:
        """Return the poses of a run, by mounting: at the angle of each pose, else at the only one planned."""
        lots: dict[float | None, list[Pose]] = {}
        for pose in poses:
            own = pose.covariates.get(MOUNT_DEG)
            bare = replace(pose, covariates={k: v for k, v in pose.covariates.items() if k != MOUNT_DEG})
            alone = float(planned_deg[0]) if own is None and len(planned_deg) == 1 else own
            lots.setdefault(alone, []).append(bare)
        return [
            cls(unit, f"{name} {angle or 0.0:g}°", angle, run_id, own, axis) for angle, own in lots.items()
        ]

    @property
    def sense(self) -> int:
        """+1, or −1 where the elevation falls as the dial's angle rises."""
        return _sense(self.axis)


@dataclass(frozen=True, slots=True)
class Mount:
    """One clamping: label, unit by index, stated angle, and the unit's axis that lies along the stage's."""

    name: str
    unit: int
    nominal_deg: float | None
    axis: str = "x"

    @property
    def sense(self) -> int:
        """−1 of a unit that was reversed (`mount_axis` −x): its elevation falls as the dial rises."""
        return _sense(self.axis)

    def on_its_turn(self, angle_deg: float) -> float:
        """An angle that was found, within half a turn of the one stated: 241° where that was 240°."""
        nominal_deg = self.nominal_deg or 0.0
        return nominal_deg + float(wrap_deg(angle_deg - nominal_deg))


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """n poses in columns.

    Attributes:
        units: serial numbers.
        mounts: each clamping.
        sources: files or runs; `source` (n,) has the index of each pose's.
        mount: (n,) index of each pose's mount, rising.
        dial_deg: (n,) the stage's own angle.
        approach: (n,) +1 or −1; 0 where it is not known.
        warmer_c: (n,) die temperature less its unit's reference; 0 where it is not known.
        reference_c: (units,) that reference, NaN where the unit's temperature is not known or never changed.
        vector_g: (n, 3) a_x, a_y, a_z; NaN where the pose has the reading alone, a_x 0 of units in the plane.
        reading: (n,) the elevation read, as a rotation of the table, rad.
        in_order: whether the poses of each source and mount come in the order measured.
        is_whole: whether all three components are solved for, and not those across x alone.
        poses: (n,) as they were measured, of whole units.
        before: (n,) the pose of the mount that the stage came from; None of the first; of whole units.
        unit: (n,) index of each pose's unit.
        sense: (n,) +1, or −1 of poses whose elevation falls as the dial's angle rises.
        has_vector: (n,) whether a pose has the accelerometer's means.
        faces: (mounts, 3, 3) from a frame whose x lies along the stage's axis to the unit's.
    """

    units: tuple[str, ...]
    mounts: tuple[Mount, ...]
    sources: tuple[str, ...]
    source: Intp
    mount: Intp
    dial_deg: FloatArray
    approach: FloatArray
    warmer_c: FloatArray
    reference_c: FloatArray
    vector_g: FloatArray
    reading: FloatArray
    in_order: bool = False
    is_whole: bool = False
    poses: tuple[Pose, ...] = ()
    before: tuple[Pose | None, ...] = ()
    unit: Intp = field(init=False, repr=False)
    sense: FloatArray = field(init=False, repr=False)
    has_vector: BoolArray = field(init=False, repr=False)
    faces: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        units = np.array([mount.unit for mount in self.mounts], dtype=np.intp)
        senses = np.array([mount.sense for mount in self.mounts], dtype=np.float64)
        object.__setattr__(self, "unit", units[self.mount])
        object.__setattr__(self, "sense", senses[self.mount])
        object.__setattr__(self, "has_vector", np.isfinite(self.vector_g).all(axis=1))
        object.__setattr__(self, "faces", np.stack([face_matrix(mount.axis) for mount in self.mounts]))

    def __len__(self) -> int:
        return len(self.dial_deg)

    @property
    def components(self) -> slice:
        """Of the vectors, those that are solved for."""
        return slice(0, 3) if self.is_whole else slice(1, 3)

    @property
    def responses(self) -> Intp:
        """(n,) how many numbers of each pose are solved for."""
        return np.where(self.has_vector, 3 if self.is_whole else 2, 1)

    @property
    def size_g(self) -> FloatArray:
        """(n,) length of the vector; NaN of a reading alone."""
        return np.asarray(np.linalg.norm(self.vector_g, axis=1))

    def turn(self) -> FloatArray:
        """(n,) the rotation of the table with its unit, by the accelerometer, else the reading."""
        return np.where(self.has_vector, self.turn_of(self.vector_g), self.reading)

    def turn_of(self, vector_g: FloatArray) -> FloatArray:
        """(n,) the angle about the stage's axis of vectors (n, 3), rad."""
        seen = np.einsum("ni,nij->nj", vector_g, self.faces[self.mount])
        return np.asarray(np.arctan2(seen[:, 1], seen[:, 2]))

    def rows(self, chosen: Intp | BoolArray) -> Table:
        """The same mounts with some of the poses."""
        names = ("source", "mount", "dial_deg", "approach", "warmer_c", "vector_g", "reading")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


def are_whole(lots: Sequence[MountedPoses]) -> bool:
    """Return whether any unit was clamped with its y or z along the stage's axis.

    Raises:
        DiagnosisError: an axis is none.
    """
    return any(_face(lot)[-1] != "x" for lot in lots)


def table_of(lots: Sequence[MountedPoses]) -> tuple[Table, list[str]]:
    """Return the poses in columns, and warnings of how they were taken.

    Raises:
        DiagnosisError: they cannot be what they are said to be; names the file and the mount.
    """
    return _table_of_whole_units(lots) if are_whole(lots) else _table_about_x(lots)


def _table_about_x(lots: Sequence[MountedPoses]) -> tuple[Table, list[str]]:
    """The poses of mounts about x or −x in columns, and warnings."""
    _refuse_twice(lots)
    warnings: list[str] = []
    kept = [_checked_about_x(lot, warnings) for lot in lots]
    by_name: dict[tuple[str, str], list[MountedPoses]] = defaultdict(list)
    for lot in kept:
        by_name[lot.unit, lot.mount].append(lot)
    for name, same in list(by_name.items()):
        _refuse_overlap(same)
        n = sum(len(lot.poses) for lot in same)
        if n < FEWEST_OF_A_MOUNT:
            warnings.append(
                f"mount {same[0].mount} of unit {same[0].unit} has {n} pose: its angle alone takes that up; "
                "it was left out"
            )
            del by_name[name]
    n = sum(len(lot.poses) for same in by_name.values() for lot in same)
    if n < FEWEST_POSES:
        why = f" ({'; '.join(warnings[:MOST_QUOTED])})" if warnings else ""
        raise DiagnosisError(f"{n} poses are too few: at least {FEWEST_POSES} are needed{why}")
    return _columns(list(by_name.values())), warnings


def _checked_about_x(lot: MountedPoses, warnings: list[str]) -> MountedPoses:
    """The lot with the poses that can be used."""
    runs, said = complete([lot.poses])
    run = runs[0] if runs else []
    warnings += [f"{lot.source}, mount {lot.mount}: {sentence}" for sentence in said]
    warnings += _at_two_places(lot)
    found = MountedPoses(lot.unit, lot.mount, lot.nominal_deg, lot.source, run, lot.axis)
    if not run:
        return found
    _refuse_no_gravity(found)
    dial, reading = _dial_deg(run), np.array([pose.reading_deg for pose in run])
    table_at = found.sense * dial
    on_the_dials_turn = table_at + wrap_deg(reading - table_at - _angle_deg(found))
    try:
        refuse_what_is_no_elevation(table_at, on_the_dials_turn)
    except DiagnosisError as error:
        raise DiagnosisError(f"{lot.source}, mount {lot.mount}: {error}") from error
    along, against = (abs(np.exp(1j * np.radians(reading - sign * table_at)).mean()) for sign in (1.0, -1.0))
    if along < TOGETHER:
        axis = "x" if found.sense < 0 else "-x"
        why = (
            f"the readings turn against the stage: did it lie the other way round (mount_axis {axis})?"
            if against > TOGETHER
            else "no single angle fits its poses: is it several mounts under one name?"
        )
        raise DiagnosisError(f"{lot.source}: mount {lot.mount} of unit {lot.unit}: {why}")
    return found


def _refuse_no_gravity(lot: MountedPoses) -> None:
    """Vectors of a unit at rest are 1 g long, but for a few that went wrong."""
    vectors = _vectors(lot.poses)
    size_g = float(np.median(np.linalg.norm(vectors, axis=1)))
    if abs(size_g - 1.0) > GROSS_G:
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount}: accel_y_g and accel_z_g together are {size_g:g} g long, and "
            "a unit at rest whose x lies along the stage measures 1 g"
        )


def _refuse_twice(lots: Sequence[MountedPoses]) -> None:
    """Most poses of one lot in another, whatever it is called: a few may be alike by chance."""
    first: dict[Figures, int] = {}
    for k, lot in enumerate(lots):
        own = {_figures(pose) for pose in lot.poses}
        for other, same in Counter(first[figures] for figures in own if figures in first).items():
            one = lots[other]
            if 1 < same > 0.5 * min(len(own), len(one.poses)):
                how_many = "the very same" if same == len(own) else f"{same} of the same"
                raise DiagnosisError(
                    f"{lot.source} (unit {lot.unit}, mount {lot.mount}) holds {how_many} poses as "
                    f"{one.source} (unit {one.unit}, mount {one.mount}): it was given twice"
                )
        first |= dict.fromkeys(own, k)


Figures = tuple[float, float]


def _figures(pose: Pose) -> Figures:
    """Return what is equal for a pose in a file that was written again, with fewer digits or columns."""
    return round(pose.theta_deg, 3), round(pose.reading_deg % 360.0, 3)


def _at_two_places(lot: MountedPoses) -> list[str]:
    """A stage stands at one angle at a time."""
    at_time: dict[float, float] = {}
    for pose in lot.poses:
        if pose.time_s is None:
            continue
        one, other = at_time.setdefault(pose.time_s, pose.theta_deg), pose.theta_deg
        if abs(one - other) > APART_DEG:
            return [
                f"{lot.source}, mount {lot.mount} of unit {lot.unit}: at {pose.time_s:g} s its stage stands "
                f"at {one:g}° and at {other:g}°: two units of one name, or two runs under one mount?"
            ]
    return []


def _refuse_overlap(same: Sequence[MountedPoses]) -> None:
    """Lots of one name stand at one angle, as said and as gravity has it."""
    for one, other in combinations([lot for lot in same if lot.poses], 2):
        named = one.nominal_deg, other.nominal_deg
        if None not in named and abs(wrap_deg(float(named[0]) - float(named[1]))) > 1e-6:  # type: ignore[arg-type]
            apart = f"was clamped at {named[0]:g}° and at {named[1]:g}°"
        elif one.sense != other.sense:
            apart = f"has its axis {one.axis} and its axis {other.axis} along the stage's"
        elif abs(wrap_deg(_angle_deg(one) - _angle_deg(other))) > SAME_DEG:
            apart = f"stands at {_angle_deg(one):.0f}° and at {_angle_deg(other):.0f}° by gravity"
        else:
            continue
        raise DiagnosisError(
            f"mount {one.mount} of unit {one.unit} {apart} ({one.source}, {other.source}): give each "
            "remounting a name of its own"
        )


def _angle_deg(lot: MountedPoses) -> float:
    """Reading less what the dial makes of it, as the mean over the poses."""
    reading = np.array([pose.reading_deg for pose in lot.poses])
    apart = reading - lot.sense * _dial_deg(lot.poses)
    return float(np.degrees(np.angle(np.exp(1j * np.radians(apart)).sum())))


def _dial_deg(poses: Sequence[Pose]) -> FloatArray:
    return np.array([pose.dial_deg for pose in poses], dtype=np.float64)


def _columns(mounts: Sequence[Sequence[MountedPoses]]) -> Table:
    units = tuple(dict.fromkeys(same[0].unit for same in mounts))
    sources = tuple(dict.fromkeys(lot.source for same in mounts for lot in same))
    lots = [(k, lot) for k, same in enumerate(mounts) for lot in same if lot.poses]
    poses = [pose for _, lot in lots for pose in lot.poses]
    length = [len(lot.poses) for _, lot in lots]
    own_unit = np.repeat([units.index(lot.unit) for _, lot in lots], length)
    warmer_c, reference_c = _temperatures(poses, own_unit, len(units))
    senses = [approach_of(lot.poses) for _, lot in lots]
    return Table(
        units=units,
        mounts=tuple(
            Mount(same[0].mount, units.index(same[0].unit), same[0].nominal_deg, _face(same[0]))
            for same in mounts
        ),
        sources=sources,
        source=np.repeat([sources.index(lot.source) for _, lot in lots], length),
        mount=np.repeat([k for k, _ in lots], length),
        dial_deg=_dial_deg(poses),
        approach=np.concatenate(
            [np.zeros(n) if a is None else a for a, n in zip(senses, length, strict=True)]
        ),
        warmer_c=warmer_c,
        reference_c=reference_c,
        vector_g=np.concatenate([_vectors(lot.poses) for _, lot in lots]),
        reading=np.radians([lot.sense * pose.reading_deg for _, lot in lots for pose in lot.poses]),
        in_order=all(has_history(lot.poses) for _, lot in lots),
    )


def _vectors(poses: Sequence[Pose]) -> FloatArray:
    """(n, 3) 0, a_y and a_z; NaN where any pose of the lot lacks them."""
    vectors = [(0.0, pose.accel_y_g, pose.accel_z_g) for pose in poses]
    known = all(value is not None for vector in vectors for value in vector)
    return np.array(vectors, dtype=np.float64) if known else np.full((len(poses), 3), np.nan)


def _temperatures(poses: Sequence[Pose], unit: FloatArray, n_units: int) -> tuple[FloatArray, FloatArray]:
    """Return (n,) temperature less its unit's mean, 0 if unknown, and (units,) that mean, NaN if unknown."""
    celsius = np.array([np.nan if p.temperature_c is None else p.temperature_c for p in poses])
    warmer, reference = np.zeros(len(poses)), np.full(n_units, np.nan)
    for k in range(n_units):
        own = celsius[unit == k]
        if np.isfinite(own).all() and np.ptp(own) > LEAST_TEMPERATURE_RANGE_C:
            reference[k] = own.mean()
            warmer[unit == k] = own - reference[k]
    return warmer, reference


def _table_of_whole_units(lots: Sequence[MountedPoses]) -> tuple[Table, list[str]]:
    """The poses of units clamped by any of their axes, and warnings."""
    warnings: list[str] = []
    checked = [found for lot in lots if (found := _checked_whole(lot, warnings)) is not None]
    if not checked:
        raise DiagnosisError(f"no pose has all of gravity's components: {'; '.join(warnings[:MOST_QUOTED])}")
    own = _named_by_face(checked)
    seen, said = _table_about_x([_about_x(lot) for lot in own])
    of_mount: dict[tuple[str, str], list[MountedPoses]] = defaultdict(list)
    for lot in own:
        of_mount[lot.unit, lot.mount].append(lot)
    in_order = [of_mount[seen.units[mount.unit], mount.name] for mount in seen.mounts]
    poses = tuple(pose for same in in_order for lot in same for pose in lot.poses)
    mounts = (replace(mount, axis=_face(same[0])) for mount, same in zip(seen.mounts, in_order, strict=True))
    came_from = {id(now): before for lot in lots for before, now in pairwise(lot.poses)}
    table = replace(
        seen,
        mounts=tuple(mounts),
        vector_g=_whole_vectors(poses),
        is_whole=True,
        poses=poses,
        before=tuple(came_from.get(id(pose)) for pose in poses),
    )
    return table, [*warnings, *said]


def _checked_whole(lot: MountedPoses, warnings: list[str]) -> MountedPoses | None:
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
    vectors, face = _whole_vectors(runs[0]), _face(lot)
    size_g = float(np.median(np.linalg.norm(vectors, axis=1)))
    if abs(size_g - 1.0) > GROSS_G:
        raise DiagnosisError(f"{where}: |a| is {size_g:g} g, and a unit at rest measures 1 g")
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
            f"{lot.source}: mount {lot.mount} of unit {lot.unit}: mount_axis is {lot.axis!r}, "
            f"which is none of {', '.join(FACES)}"
        )
    return face


def _about_x(lot: MountedPoses) -> MountedPoses:
    """The lot as of a unit whose x lies along the stage's axis."""
    vectors = _whole_vectors(lot.poses) @ face_matrix(_face(lot))
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


def _whole_vectors(poses: Sequence[Pose]) -> FloatArray:
    return np.array([(pose.accel_x_g, pose.accel_y_g, pose.accel_z_g) for pose in poses], dtype=np.float64)
