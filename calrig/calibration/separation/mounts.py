"""Poses that have gone wrong alone: found by fits in which those far off count less, then left out.

From clampings as they were named to a table: what overlaps, wraps or comes twice is refused or said.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import TypeVar

import numpy as np

from calrig.calibration.diagnosis.selection import most_outliers
from calrig.calibration.poses import DiagnosisError, Pose, complete, refuse_what_is_no_elevation
from calrig.calibration.regression.motion import approach_of, has_history
from calrig.calibration.regression.terms import LEAST_TEMPERATURE_RANGE_C
from calrig.calibration.separation.pose_table import SENSES, BoolArray, Mount, MountedPoses, Table
from calrig.calibration.separation.stage_map import Linearised
from calrig.estimation.angles import FloatArray, wrap_deg

OUTLIER_STD = 7.0
"""Standard deviations from the model, beyond which noise takes no pose."""
ROUNDS = 4
GROSS_G = 0.5
"""A vector whose length is off by more is none of gravity."""
MOST_NAMED = 5
"""Of the poses that were left out, how many are named."""


FitT = TypeVar("FitT", bound=Linearised)


def fitted_without_outliers(
    fitting: Callable[[FloatArray, FloatArray | None, bool], FitT],
    distances: Callable[[FitT], FloatArray],
    size_g: FloatArray,
) -> tuple[FitT, FloatArray]:
    """A fit, and the weights (n,) of the poses: 0 of those that have gone wrong alone.

    Where many are far off it is the model that is wrong, and none is left out.

    Args:
        fitting: of the problem, by weights (n,), where to begin (p,), and whether poses far off count less.
        distances: (n,) how far each pose lies from what the others say of it, in standard deviations.
        size_g: (n,) of each pose's vector; NaN of a reading alone.
    """
    gross = np.abs(size_g - 1.0) > GROSS_G
    weights = np.where(gross, 0.0, 1.0)
    fit = fitting(weights, None, True)
    for _ in range(ROUNDS):
        outlying = gross | (distances(fit) > OUTLIER_STD)
        if outlying.sum() > most_outliers(len(outlying)):
            weights = np.where(gross, 0.0, 1.0)
            break
        if (outlying == (weights == 0.0)).all():
            break
        weights = np.where(outlying, 0.0, 1.0)
        fit = fitting(weights, fit.parameters, True)
    return fitting(weights, fit.parameters, False), weights


def outliers_said(table: Table, kept: BoolArray, distances: FloatArray) -> list[str]:
    """Poses that were left out, each by its place; and how many (n,) lie as far off and were not."""
    said = []
    left_out = np.flatnonzero(~kept)
    if len(left_out):
        listed = ", ".join(
            f"{table.mounts[table.mount[k]].name} at {table.dial_deg[k]:g}°" for k in left_out[:MOST_NAMED]
        )
        said.append(f"{len(left_out)} outliers were left out: {listed}")
    far = int((distances[kept] > OUTLIER_STD).sum())
    if far:
        said.append(f"{far} poses lie far from the model, too many to be left out: something else moved")
    return said


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


def table_of(lots: Sequence[MountedPoses]) -> tuple[Table, list[str]]:
    """The poses in columns, and what a person should know of how they were taken.

    Raises:
        DiagnosisError: they cannot be what they are said to be; names the file and the mount.
    """
    _refuse_twice(lots)
    warnings: list[str] = []
    kept = [_checked(lot, warnings) for lot in lots]
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
        why = f" ({'; '.join(warnings[:TOLD])})" if warnings else ""
        raise DiagnosisError(f"{n} poses are too few: at least {FEWEST_POSES} are needed{why}")
    return _columns(list(by_name.values())), warnings


def _checked(lot: MountedPoses, warnings: list[str]) -> MountedPoses:
    """The lot with the poses that can be used."""
    _refuse_axis(lot)
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


def _refuse_axis(lot: MountedPoses) -> None:
    who = f"{lot.source}: mount {lot.mount} of unit {lot.unit}"
    if lot.axis.lstrip("+-") not in ("x", "y", "z") or len(lot.axis) > len("-x"):
        raise DiagnosisError(f"{who}: mount_axis is {lot.axis!r}, which is none of x, y, z, -x, -y, -z")
    if lot.axis not in SENSES:
        raise DiagnosisError(
            f"{who} has its axis {lot.axis} along the stage's; only x and -x are solved for so far"
        )


def _refuse_no_gravity(lot: MountedPoses) -> None:
    """Vectors of a unit at rest are 1 g long, but for a few that went wrong."""
    vectors = _vectors(lot.poses)
    size_g = float(np.median(np.hypot(vectors[:, 0], vectors[:, 1])))
    if abs(size_g - 1.0) > GROSS_G:
        raise DiagnosisError(
            f"{lot.source}: mount {lot.mount}: accel_y_g and accel_z_g together are {size_g:g} g long, and "
            "a unit at rest whose x lies along the stage feels 1 g"
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
    """What is the same of a pose in a file that was written anew, with fewer digits or columns."""
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
            f"mount {one.mount} of unit {one.unit} {apart} ({one.source}, {other.source}): give what was "
            "clamped anew a name of its own"
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
