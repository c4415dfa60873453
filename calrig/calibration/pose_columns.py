"""Columns of poses as a diagnosis takes them: what is missing, what says nothing, what cannot be meant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.pose import COLUMNS, OF_MOUNTS, DiagnosisError, Pose, of_first_mount
from calrig.estimation.angles import FloatArray

SAME = 1.0 - 1e-6
"""Columns correlated beyond this are one column."""


def complete(runs: Sequence[Sequence[Pose]]) -> tuple[list[list[Pose]], list[str]]:
    """The runs that have poses; a column that a few poses lack costs those poses, not the column.

    Of a run with several mounts, its first one's poses.
    """
    warnings = []
    given, runs = runs, [of_first_mount(run) for run in runs]
    left_out = sum(map(len, given)) - sum(map(len, runs))
    if left_out:
        warnings.append(
            f"{left_out} poses were taken with the unit clamped at another angle and were left out: a "
            "diagnosis is of one mount; `solve` takes all of them together"
        )
    poses = [pose for run in runs for pose in run]
    lacking: set[int] = set()
    for name in ("temperature_c", "time_s", "approach", "accel_y_g", "accel_z_g", "stage_deg"):
        missing = [k for k, pose in enumerate(poses) if getattr(pose, name) is None]
        if 0 < len(missing) <= 0.1 * len(poses):
            warnings.append(f"{len(missing)} poses have no {name} and were left out")
            lacking.update(missing)
        elif 0 < len(missing) < len(poses):
            warnings.append(f"{name} is missing from {len(missing)} poses: the column was not used")
    kept, k = [], 0
    for run in runs:
        kept.append([pose for i, pose in enumerate(run, start=k) if i not in lacking])
        k += len(run)
    return [run for run in kept if run], warnings


def column_of(poses: Sequence[Pose], name: str) -> FloatArray | None:
    """(n,) one column of the poses, None where any pose lacks it."""
    values = [getattr(pose, name) for pose in poses]
    return None if any(value is None for value in values) else np.array(values, dtype=np.float64)


def covariates_of(
    poses: Sequence[Pose], theta: FloatArray, reading: FloatArray
) -> tuple[dict[str, FloatArray], list[str]]:
    """The unknown columns worth looking at, and what was said of the others."""
    names = dict.fromkeys(
        name for pose in poses for name in pose.covariates if name not in (*COLUMNS, *OF_MOUNTS)
    )
    taken: dict[str, FloatArray] = {
        "the order of the poses": np.arange(len(poses), dtype=float),
        "the elevation": theta,
        "the reading": reading,
    }
    for known in ("time_s", "temperature_c", "accel_y_g", "accel_z_g", "gyro_move_deg", "accel_x_g"):
        column = column_of(poses, known)
        if column is not None:
            taken[known] = column
    found: dict[str, FloatArray] = {}
    warnings = []
    for name in names:
        values = [pose.covariates.get(name) for pose in poses]
        if any(value is None for value in values):
            warnings.append(f"column {name} is not known of every pose: it was not used")
            continue
        column = np.array(values, dtype=np.float64)
        if np.ptp(column) == 0.0:
            continue
        twin = next((other for other, known in taken.items() if same(column, known)), None)
        if twin is not None:
            warnings.append(f"column {name} says the same as {twin}: it was not used")
            continue
        found[name] = taken[name] = column
    return found, warnings


def same(a: FloatArray, b: FloatArray) -> bool:
    """Whether one column is the other in other units."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return bool(abs(np.corrcoef(a, b)[0, 1]) > SAME)


def refuse_what_is_no_elevation(theta: FloatArray, reading: FloatArray) -> None:
    """Raises DiagnosisError where the readings cannot be degrees of these elevations."""
    if np.ptp(theta) < 5.0:
        return
    if np.ptp(reading) == 0.0:
        raise DiagnosisError(
            f"the readings never change (they all are {reading[0]:g}) while the elevation turns by "
            f"{np.ptp(theta):g}°: look at reading_deg and at what fills it"
        )
    slope = float(np.polyfit(theta, reading, 1)[0])
    if abs(abs(slope) * 180.0 / np.pi - 1.0) < 0.2:
        raise DiagnosisError(
            f"the readings change by {slope:.4f} per degree of elevation: they look like radians; "
            "convert reading_deg to degrees"
        )
