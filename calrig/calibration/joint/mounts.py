"""From clampings as they were named to a table: what overlaps, wraps or comes twice is refused or said."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from calrig.calibration.joint.least_squares import GROSS_G
from calrig.calibration.joint.table import Mount, Mounted, Table
from calrig.calibration.motion import approach_of, has_history
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.pose_columns import complete, refuse_what_is_no_elevation
from calrig.estimation.angles import FloatArray, wrap_deg

FEWEST_POSES = 8
FEWEST_OF_A_MOUNT = 2
SAME_DEG = 12.0
"""Two lots of poses of one mount differ by no more: errors of 150 mg turn a vector by 9°."""
LEAST_TEMPERATURE_RANGE_C = 0.05
TOLD = 3
"""Of the warnings, in an error."""
TOGETHER = 0.7
"""Mean resultant length of reading less dial: poses of one mount lie within some 40° of each other."""


def table_of(lots: Sequence[Mounted]) -> tuple[Table, list[str]]:
    """The poses in columns, and what a person should know of how they were taken.

    Raises:
        DiagnosisError: they cannot be what they are said to be; names the file and the mount.
    """
    _refuse_twice(lots)
    warnings: list[str] = []
    kept = [_checked(lot, warnings) for lot in lots]
    by_name: dict[tuple[str, str], list[Mounted]] = defaultdict(list)
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
        why = f" ({'; '.join(warnings[:TOLD])})" if warnings else ""
        raise DiagnosisError(f"{n} poses are too few: at least {FEWEST_POSES} are needed{why}")
    return _columns(list(by_name.values())), warnings


def _checked(lot: Mounted, warnings: list[str]) -> Mounted:
    """The lot with the poses that can be used."""
    if lot.axis.removeprefix("+") != "x":
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount} has its axis {lot.axis} along the stage's; "
            "only x is solved for so far"
        )
    runs, said = complete([lot.poses])
    run = runs[0] if runs else []
    warnings += [f"{lot.source}, mount {lot.mount}: {sentence}" for sentence in said]
    found = Mounted(lot.unit, lot.mount, lot.nominal_deg, lot.source, run, lot.axis)
    if not run:
        return found
    _refuse_no_gravity(found)
    dial, reading = _dial_deg(run), np.array([pose.reading_deg for pose in run])
    on_the_dials_turn = dial + wrap_deg(reading - dial - _angle_deg(run))
    try:
        refuse_what_is_no_elevation(dial, on_the_dials_turn)
    except DiagnosisError as error:
        raise DiagnosisError(f"{lot.source}, mount {lot.mount}: {error}") from error
    along, against = (abs(np.exp(1j * np.radians(reading - sign * dial)).mean()) for sign in (1.0, -1.0))
    if along < TOGETHER:
        turns = (
            "the readings turn against the stage" if against > TOGETHER else "no single angle fits its poses"
        )
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount} of unit {lot.unit}: {turns}: is it several mounts under one "
            "name, or the unit the other way round on its stage?"
        )
    return found


def _refuse_no_gravity(lot: Mounted) -> None:
    """Vectors of a unit at rest are 1 g long, but for a few that went wrong."""
    vectors = _vectors(lot.poses)
    size_g = float(np.median(np.hypot(vectors[:, 0], vectors[:, 1])))
    if abs(size_g - 1.0) > GROSS_G:
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount}: accel_y_g and accel_z_g together are {size_g:g} g long, and "
            "a unit at rest whose x lies along the stage feels 1 g"
        )


def _refuse_twice(lots: Sequence[Mounted]) -> None:
    seen: dict[tuple[Figures, ...], Mounted] = {}
    for lot in lots:
        one = seen.setdefault(tuple(map(_figures, lot.poses)), lot)
        if one is not lot and len(lot.poses) > 1:
            raise DiagnosisError(
                f"{lot.source} (unit {lot.unit}, mount {lot.mount}) holds the very same poses as "
                f"{one.source} (unit {one.unit}, mount {one.mount}): it was given twice"
            )


Figures = tuple[float | None, ...]


def _figures(pose: Pose) -> Figures:
    return pose.target_deg, pose.stage_deg, pose.reading_deg, pose.accel_y_g, pose.accel_z_g


def _refuse_overlap(same: Sequence[Mounted]) -> None:
    """Lots of one name stand at one angle, as said and as gravity has it."""
    for one, other in combinations([lot for lot in same if lot.poses], 2):
        named = one.nominal_deg, other.nominal_deg
        if None not in named and abs(wrap_deg(float(named[0]) - float(named[1]))) > 1e-6:  # type: ignore[arg-type]
            apart = f"was clamped at {named[0]:g}° and at {named[1]:g}°"
        elif abs(wrap_deg(_angle_deg(one.poses) - _angle_deg(other.poses))) > SAME_DEG:
            apart = f"stands at {_angle_deg(one.poses):.0f}° and at {_angle_deg(other.poses):.0f}° by gravity"
        else:
            continue
        raise DiagnosisError(
            f"mount {one.mount} of unit {one.unit} {apart} ({one.source}, {other.source}): give what was "
            "clamped anew a name of its own"
        )


def _angle_deg(poses: Sequence[Pose]) -> float:
    """Reading less dial, as the mean over the poses."""
    reading = np.array([pose.reading_deg for pose in poses])
    return float(np.degrees(np.angle(np.exp(1j * np.radians(reading - _dial_deg(poses))).sum())))


def _dial_deg(poses: Sequence[Pose]) -> FloatArray:
    return np.array([pose.dial_deg for pose in poses], dtype=np.float64)


def _columns(mounts: Sequence[Sequence[Mounted]]) -> Table:
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
        mounts=tuple(Mount(same[0].mount, units.index(same[0].unit), same[0].nominal_deg) for same in mounts),
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
        reading=np.radians([pose.reading_deg for pose in poses]),
        in_order=all(has_history(lot.poses) for _, lot in lots),
    )


def _known(sense: FloatArray | None, n: int) -> FloatArray:
    return np.zeros(n) if sense is None else sense


def _vectors(poses: Sequence[Pose]) -> FloatArray:
    """(n, 2) a_y and a_z; NaN where any pose of the lot lacks them."""
    vectors = [(pose.accel_y_g, pose.accel_z_g) for pose in poses]
    known = all(value is not None for vector in vectors for value in vector)
    return np.array(vectors, dtype=np.float64) if known else np.full((len(poses), 2), np.nan)


def _temperatures(poses: Sequence[Pose], unit: FloatArray, n_units: int) -> tuple[FloatArray, FloatArray]:
    """(n,) temperature less its unit's mean, 0 where not known, and (units,) that mean, NaN likewise."""
    celsius = np.array([np.nan if p.temperature_c is None else p.temperature_c for p in poses])
    warmer, reference = np.zeros(len(poses)), np.full(n_units, np.nan)
    for k in range(n_units):
        own = celsius[unit == k]
        if np.isfinite(own).all() and np.ptp(own) > LEAST_TEMPERATURE_RANGE_C:
            reference[k] = own.mean()
            warmer[unit == k] = own - reference[k]
    return warmer, reference
