"""A pose (one dwell at one elevation), its columns (CONTRACT section 4), and checks before a diagnosis."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from calrig.calibration.line import reading_error_deg
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.estimation.kalman import KalmanNoise

REQUIRED = ("target_deg", "reading_deg")
INTEGER = ("pass", "approach", "n_samples")
KNOWN = (
    "pass",
    "approach",
    "time_s",
    "temperature_c",
    "stage_deg",
    "reading_std_deg",
    "reading_stderr_deg",
    "n_samples",
    "accel_x_g",
    "accel_y_g",
    "accel_z_g",
    "gyro_move_deg",
    "settle_s",
)
COLUMNS = (*REQUIRED, *KNOWN)
GYRO_MEANS = ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps")
"""Among the covariates: what each axis of the gyro says of the dwell."""
GYRO_MOVES = ("gyro_move_x_deg", "gyro_move_y_deg", "gyro_move_z_deg")
"""Likewise, of a run with mounts: of the move into it."""
MOUNT_DEG = "mount_deg"
"""Likewise: the angle at which the unit was clamped; 0 where it is not said."""
HOST_TIME = "host_time_s"
"""Likewise: when the pose was taken by the host's clock, beside `time_s` by the board's."""
OF_MOUNTS = (MOUNT_DEG, *GYRO_MEANS, *GYRO_MOVES)
"""What no diagnosis of elevations looks into, though covariates in the store."""


class DiagnosisError(ValueError):
    """The poses cannot be diagnosed; the message says what is wrong with them and what to do."""


@dataclass(frozen=True, slots=True)
class Filtering:
    """The filter that poses were read by, its rate, and how long a dwell was; the contract's by default.

    `remembers` is False where what it still shows of the moves has been taken off the readings. Velocity and
    acceleration are those of the elevation, as the stage's controller tells them: None where it does not, and
    a move is taken for as long as what lies between two dwells.
    """

    noise: KalmanNoise = field(default_factory=KalmanNoise)
    rate_hz: float = 200.0
    dwell_s: float = 2.0
    remembers: bool = True
    velocity_dps: float | None = None
    acceleration_dps2: float | None = None


@dataclass(frozen=True, slots=True)
class Pose:
    """One pose; what is not known is None. Every further numeric column of a file is a covariate.

    Attributes:
        sweep: index of the sweep from 0 (column `pass`).
        approach: +1 or −1, the sense of the last move that moved the stage; 0 where unknown.
        time_s: since the run began, at mid-dwell.
        reading_std_deg: spread of the filtered samples in the dwell.
        reading_stderr_deg: standard error of the reading, allowing for the filter's correlation.
        gyro_move_deg: rate about the stage axis, less its bias, integrated over the move into the pose; None
            where samples are missing or too few carry it.
        covariates: further columns by name.
        filtering: of the run it belongs to, where that is known; no column of a file.
        map_deg: what the stage's map in force for its run adds to the dial; no column of a file either.
    """

    target_deg: float
    reading_deg: float
    sweep: int | None = None
    approach: int | None = None
    time_s: float | None = None
    temperature_c: float | None = None
    stage_deg: float | None = None
    reading_std_deg: float | None = None
    reading_stderr_deg: float | None = None
    n_samples: int | None = None
    accel_x_g: float | None = None
    accel_y_g: float | None = None
    accel_z_g: float | None = None
    gyro_move_deg: float | None = None
    settle_s: float | None = None
    covariates: dict[str, float | None] = field(default_factory=dict)
    filtering: Filtering | None = field(default=None, compare=False, repr=False)
    map_deg: float | None = field(default=None, compare=False, repr=False)

    @property
    def settled(self) -> bool:
        """Whether it is a dwell after a move, as far as is known; a stretch of a turn tells no settling."""
        return self.settle_s is not None or self.filtering is None or self.filtering.remembers

    @property
    def dial_deg(self) -> float:
        """The angle of the dial: what the stage reported, else what was commanded.

        A report within one turn is taken on the turn of the command.
        """
        if self.stage_deg is None:
            return self.target_deg
        off_deg = self.stage_deg - self.target_deg
        return self.stage_deg if abs(off_deg) <= 180.0 else self.target_deg + wrap_deg(off_deg)

    @property
    def mount_deg(self) -> float:
        """The angle at which the unit was clamped, nominally."""
        return self.covariates.get(MOUNT_DEG) or 0.0

    @property
    def theta_deg(self) -> float:
        """The elevation the pose stands for: the stage's angle and, on the half turn about 0, the mount's.

        The stage's angle is put right by its map, where one was in force.
        """
        theta_deg = self.dial_deg + (self.map_deg or 0.0)
        return theta_deg + wrap_deg(self.mount_deg) if MOUNT_DEG in self.covariates else theta_deg

    def row(self) -> dict[str, float | int | None]:
        """Return the pose as CONTRACT section 4's columns, covariates after them."""
        known = {name: getattr(self, _attribute(name)) for name in COLUMNS}
        return {**known, **self.covariates}

    @classmethod
    def from_row(cls, row: dict[str, float | int | None]) -> Self:
        """Return the pose of a row as `row()` gives it."""
        known = {_attribute(name): row[name] for name in COLUMNS if name in row}
        extra = {name: value for name, value in row.items() if name not in COLUMNS}
        return cls(**known, covariates=extra)  # type: ignore[arg-type]


def of_first_mount(poses: Sequence[Pose]) -> Sequence[Pose]:
    """Return the poses taken at the mount of the first one.

    Each mount's own angle is not known better than a hand clamps, and the stage's errors turn with the dial
    and not with the elevation: only a joint solution makes something of several mounts.
    """
    if not poses or all(pose.mount_deg == poses[0].mount_deg for pose in poses):
        return poses
    return [pose for pose in poses if pose.mount_deg == poses[0].mount_deg]


def _attribute(column: str) -> str:
    return "sweep" if column == "pass" else column


SAME = 1.0 - 1e-6
"""Columns correlated beyond this are one column."""
ERROR, ROUNDED_TO = "the reading less the elevation", 0.05
"""What loggers write beside these, with either sign or none; what share of its range rounding may be."""
FOLLOWS, MOST_OFF_DEG = 0.999, 90.0
"""Correlation beyond which a column is another measurement of the elevation, counted on over turns: as an
influence quantity it would take the place of the scale. Of an angle it is within so much of the elevation.
"""


USED_WHOLE = ("temperature_c", "time_s", "approach", "accel_y_g", "accel_z_g", "stage_deg")
"""Columns that are used where every pose has them."""
FEW = 0.1
"""Of the poses: if no more lack a column, they are left out, and not the column."""


def complete(runs: Sequence[Sequence[Pose]]) -> tuple[list[list[Pose]], list[str]]:
    """Return the runs that have poses; a column that a few poses lack costs those poses, not the column.

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
    for name in USED_WHOLE:
        missing = [k for k, pose in enumerate(poses) if getattr(pose, name) is None]
        if 0 < len(missing) <= FEW * len(poses):
            warnings.append(f"{len(missing)} poses have no {name} and were left out")
            lacking.update(missing)
        elif 0 < len(missing) < len(poses):
            warnings.append(f"{name} is missing from {len(missing)} poses: the column was not used")
    kept, k = [], 0
    for run in runs:
        kept.append([pose for i, pose in enumerate(run, start=k) if i not in lacking])
        k += len(run)
    return [run for run in kept if run], warnings


def without_unused(runs: Sequence[Sequence[Pose]]) -> list[list[Pose]]:
    """Return the runs without columns that some pose lacks, so that further poses bring none back."""
    unused: dict[str, Any] = {
        name: None for name in USED_WHOLE if any(getattr(p, name) is None for run in runs for p in run)
    }
    return [[replace(pose, **unused) for pose in run] for run in runs]


def column_of(poses: Sequence[Pose], name: str) -> FloatArray | None:
    """Return (n,) one column of the poses, None where any pose lacks it."""
    values = [getattr(pose, name) for pose in poses]
    return None if any(value is None for value in values) else np.array(values, dtype=np.float64)


def covariates_of(
    poses: Sequence[Pose], theta: FloatArray, reading: FloatArray
) -> tuple[dict[str, FloatArray], list[str]]:
    """Return the unknown columns worth looking at, and what was said of the others."""
    names = dict.fromkeys(
        name for pose in poses for name in pose.covariates if name not in (*COLUMNS, *OF_MOUNTS)
    )
    taken: dict[str, FloatArray] = {
        "the order of the poses": np.arange(len(poses), dtype=float),
        "the elevation": theta,
        "the reading": reading,
        ERROR: reading_error_deg(theta, reading),
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
        off_deg = np.abs(column) - np.abs(taken[ERROR])
        low, high = np.quantile(taken[ERROR], (0.1, 0.9))
        if twin is None and np.abs(off_deg).max() <= ROUNDED_TO * (high - low):
            twin = ERROR
        if twin is not None:
            warnings.append(f"column {name} says the same as {twin}: it was not used")
            continue
        if follows(theta, column):
            warnings.append(
                f"column {name} follows the elevation (correlation above {FOLLOWS:g}), so that its influence "
                "cannot be told from the scale: it was not used"
            )
            continue
        found[name] = taken[name] = column
    return found, warnings


def follows(theta: FloatArray, column: FloatArray) -> bool:
    """Return whether a column measures the elevation again: as it is, or as an angle within one turn."""
    if np.ptp(theta) == 0.0:
        return False
    error = reading_error_deg(theta, column)
    is_near = min(np.ptp(error), np.ptp(error + 2.0 * theta)) < 2.0 * MOST_OFF_DEG
    counted = [column, theta + error] if is_near else [column]
    return any(np.ptp(one) > 0.0 and abs(np.corrcoef(theta, one)[0, 1]) > FOLLOWS for one in counted)


def same(a: FloatArray, b: FloatArray) -> bool:
    """Return whether one column is the other in other units."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return bool(abs(np.corrcoef(a, b)[0, 1]) > SAME)


FEWEST_AT_END, FLAT = 4, 0.05
"""Elevations at an end of the arc over which the readings change by less than this share of the way that they
follow: beyond the end of the sensor's range,"""
WIDER, LEAST_BEYOND = 3, 0.05
"""if no others, as coarse counts, stay so over one part in so many of that stretch, and it is at least
so much of the whole arc."""
FEWEST_FOR_UNIT_DEG, STRAIGHT, MOST_PER_DEG = 5.0, 0.3, 2.5
"""A unit shows over so many degrees, in readings that a straight line explains but for this share of their
standard deviation; at a steeper slope they are no degrees."""


def refuse_what_is_no_elevation(theta: FloatArray, reading: FloatArray) -> None:
    """Raise DiagnosisError where the readings cannot be degrees of these elevations."""
    if np.ptp(theta) > 0.0 and np.ptp(reading) == 0.0:
        raise DiagnosisError(
            f"the readings never change (they all are {reading[0]:g}) while the elevation turns by "
            f"{np.ptp(theta):g}°: look at reading_deg and at what fills it"
        )
    if np.ptp(theta) < FEWEST_FOR_UNIT_DEG:
        return
    slope, level = np.polyfit(theta, reading, 1).tolist()
    if np.std(reading - level - slope * theta) > STRAIGHT * np.std(reading):
        return  # it starts anew after a turn, or does not follow
    _refuse_its_ends(theta, reading, abs(slope))
    told = f"the readings change by {slope:.4g} per degree of elevation: "
    if abs(math.degrees(abs(slope)) - 1.0) < 0.2:
        raise DiagnosisError(f"{told}they look like radians; convert reading_deg to degrees")
    if abs(slope) > MOST_PER_DEG:
        raise DiagnosisError(
            f"{told}they look like counts, or a smaller unit; convert reading_deg to degrees"
        )


LEAST_FOLLOWED = 0.2
"""Of a step, what readings that follow change by at least."""
STAYS, FEWEST_STEPS, HALF_WAY, ARRIVED = 3, 3, 0.5, 0.9
"""Rows before and after a step at unchanged elevation; steps that tell; of the way of the reading between
them, what a stage that was waited for has behind it at its first row, and where it counts as there."""


def refuse_what_is_on_its_way(theta: FloatArray, reading: FloatArray) -> None:
    """Raise DiagnosisError where rows of one run were taken while the readings still followed a step.

    A log of a drive has the elevation that was commanded, and many rows before the drive is there.
    """
    ends = np.append(np.flatnonzero(np.diff(theta) != 0.0), len(theta) - 1)
    begins = np.append(0, ends[:-1] + 1)
    whole, rows = [], []
    for k in range(1, len(ends)):
        if min(ends[k] - begins[k], ends[k - 1] - begins[k - 1]) < STAYS - 1:
            continue
        moved = reading[begins[k] : ends[k] + 1] - reading[ends[k - 1]]
        if abs(moved[-1]) < LEAST_FOLLOWED * abs(theta[begins[k]] - theta[ends[k - 1]]):
            continue  # it does not follow, or wraps
        way = moved / moved[-1]
        whole.append(way[0])
        rows.append(int(np.argmax(way >= ARRIVED)))
    if len(whole) >= FEWEST_STEPS and np.median(whole) < HALF_WAY:
        raise DiagnosisError(
            f"after a step of target_deg the readings take {np.median(rows):.0f} rows to follow, by "
            f"{100.0 * np.median(whole):.0f} % in the first: leave out the rows on the way. If target_deg "
            "is a command, give the elevation measured with each reading; if it was measured, advance the "
            "readings by their delay"
        )


def _refuse_its_ends(theta: FloatArray, reading: FloatArray, slope: float) -> None:
    """Raise DiagnosisError where the readings stop at their highest or lowest while the elevation goes on."""
    along = np.argsort(theta, kind="stable")
    low, high = (_flat_from_an_end(theta[o], reading[o], slope) for o in (along, along[::-1]))
    between = along[low : len(along) - high]
    stops = [
        f"at {np.median(reading[there]):.5g} from {theta[there].min():g}° to {theta[there].max():g}° "
        f"({len(there)} poses)"
        for there in (along[:low], along[len(along) - high :])
        if len(there) and not _is_coarse(theta[between], reading[between], slope, theta[there])
    ]
    if stops:
        raise DiagnosisError(
            f"the readings stop {' and '.join(stops)}: if the sensor's range ends there, leave these poses "
            "out"
        )


def _flat_from_an_end(theta: FloatArray, reading: FloatArray, slope: float) -> int:
    """Return over how many of the first poses, from an end of the arc on, the readings hardly follow."""
    arc_deg = np.abs(theta - theta[0])
    spread = np.maximum.accumulate(reading) - np.minimum.accumulate(reading)
    is_flat = (spread <= FLAT * slope * arc_deg) & (arc_deg > LEAST_BEYOND * arc_deg[-1])
    count = 1 + int(np.flatnonzero(is_flat[: len(theta) // 2]).max(initial=-1))
    return count if len(np.unique(theta[:count])) >= FEWEST_AT_END else 0


def _is_coarse(theta: FloatArray, reading: FloatArray, slope: float, beyond_deg: FloatArray) -> bool:
    """Return whether readings along the arc hardly follow over stretches nearly as long as the one beyond."""
    width = max(len(beyond_deg) // WIDER, 2)
    if len(theta) < width:
        return False
    arc_deg, spread = (np.ptp(sliding_window_view(one, width), axis=1) for one in (theta, reading))
    is_long = arc_deg > np.ptp(beyond_deg) / (2 * WIDER)
    return bool((is_long & (spread <= FLAT * slope * arc_deg)).any())
