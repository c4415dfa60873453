"""From clampings as they were named to a table: what overlaps, wraps or comes twice is refused or said."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from calrig.calibration.effect_terms import LEAST_TEMPERATURE_RANGE_C
from calrig.calibration.joint.outliers import GROSS_G
from calrig.calibration.joint.table import SENSES, Mount, Mounted, Table
from calrig.calibration.motion import approach_of, has_history
from calrig.calibration.pose import DiagnosisError, Pose
from calrig.calibration.pose_columns import complete, refuse_what_is_no_elevation
from calrig.estimation.angles import FloatArray, wrap_deg

FEWEST_POSES = 8
FEWEST_OF_A_MOUNT = 2
SAME_DEG = 12.0
"""Two lots of poses of one mount differ by no more: errors of 150 mg turn a vector by 9°."""
APART_DEG = 1.0
"""Of two angles of a stage at one time, what is more than how it is read."""
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
    _refuse_axis(lot)
    runs, said = complete([lot.poses])
    run = runs[0] if runs else []
    warnings += [f"{lot.source}, mount {lot.mount}: {sentence}" for sentence in said]
    warnings += _at_two_places(lot)
    found = Mounted(lot.unit, lot.mount, lot.nominal_deg, lot.source, run, lot.axis)
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


def _refuse_axis(lot: Mounted) -> None:
    who = f"{lot.source}: mount {lot.mount} of unit {lot.unit}"
    if lot.axis.lstrip("+-") not in ("x", "y", "z") or len(lot.axis) > len("-x"):
        raise DiagnosisError(f"{who}: mount_axis is {lot.axis!r}, which is none of x, y, z, -x, -y, -z")
    if lot.axis not in SENSES:
        raise DiagnosisError(
            f"{who} has its axis {lot.axis} along the stage's; only x and -x are solved for so far"
        )


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
    """What is the same of a pose in a file that was written anew, with fewer digits or columns."""
    return round(pose.theta_deg, 3), round(pose.reading_deg % 360.0, 3)


def _at_two_places(lot: Mounted) -> list[str]:
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


def _refuse_overlap(same: Sequence[Mounted]) -> None:
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
            f"mount {one.mount} of unit {one.unit} {apart} ({one.source}, {other.source}): give what was "
            "clamped anew a name of its own"
        )


def _angle_deg(lot: Mounted) -> float:
    """Reading less what the dial makes of it, as the mean over the poses."""
    reading = np.array([pose.reading_deg for pose in lot.poses])
    apart = reading - lot.sense * _dial_deg(lot.poses)
    return float(np.degrees(np.angle(np.exp(1j * np.radians(apart)).sum())))


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
        mounts=tuple(
            Mount(same[0].mount, units.index(same[0].unit), same[0].nominal_deg, same[0].sense)
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
        reading=np.radians([pose.reading_deg for pose in poses]),
        in_order=all(has_history(lot.poses) for _, lot in lots),
    )


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
