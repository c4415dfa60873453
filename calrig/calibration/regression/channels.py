"""The channels of a regression on poses: the reading and its witnesses, with columns of bias and scale.

A witness is taken where it was measured: one that says what the reading says, or what a line explains
exactly, was not.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calrig.calibration.line import reading_error_deg
from calrig.calibration.poses import Pose, column_of, same
from calrig.estimation.angles import BoolArray, FloatArray

READING, ANGLE, NORM, MOVE, STAGE = "reading", "accel_angle", "accel_norm", "gyro_move", "stage"
CHANNELS = {
    READING: "the reading",
    ANGLE: "the accelerometer's angle",
    NORM: "|accelerometer|",
    MOVE: "the gyro over the moves",
    STAGE: "the stage's own report",
}
"""The responses in words: the reading and its witnesses."""
SCALE_UNIT_DEG = 60.0
"""Elevation enters the base in units of this, so that all its columns are of order 1."""
ONE_ANGLE_DEG = 1e-6


class Channels:
    """Gathers the responses and the columns of their bias and scale."""

    def __init__(
        self, theta: FloatArray, move: FloatArray, starts: BoolArray, run_index: npt.NDArray[np.intp]
    ) -> None:
        self.names: list[str] = []
        self.values: list[FloatArray] = []
        self.known: list[BoolArray] = []
        self.sizes: list[float] = []
        self.base_columns: list[tuple[str, str, FloatArray]] = []
        self._theta, self._move, self._starts, self._run_index = theta, move, starts, run_index
        self._runs = int(run_index[-1]) + 1
        self.turns = float(np.ptp(theta)) > ONE_ANGLE_DEG

    def add(self, name: str, values: FloatArray, size: float, *, bias_each_run: bool, scaled: bool) -> None:
        """Add a response; `size` is that of what was subtracted to get it, in its own unit."""
        self._begin(name, values, np.ones(len(values), dtype=bool), size)
        groups = range(self._runs) if bias_each_run else [None]
        for run in groups:
            one = np.ones(len(values)) if run is None else (self._run_index == run).astype(float)
            self.base_columns.append((f"{name}.bias", name, one))
        if scaled and self.turns:
            self.base_columns.append((f"{name}.scale", name, self._theta / SCALE_UNIT_DEG))

    def add_moves(self, felt_deg: FloatArray, dwells: BoolArray) -> None:
        """Add the gyro's integral (n,) over the move into each pose, degrees; NaN where it is not known.

        The bias taken off the moves of a pass of a sweep, up to that into the dwell (n,) at its end, is that
        of the dwells beside it: they share what it is wrong by, the more where the unit slipped in a dwell.
        """
        known = np.isfinite(felt_deg) & ~self._starts
        self._begin(
            MOVE, np.where(known, felt_deg - self._move, 0.0), known, turn_size(felt_deg, self._theta)
        )
        passes = np.concatenate([[0], np.cumsum(dwells)[:-1]]) if not dwells.all() else np.zeros(len(dwells))
        for one in np.unique(passes[known]):
            self.base_columns.append((f"{MOVE}.bias", MOVE, (known & (passes == one)).astype(float)))
        gain = np.where(known, self._move, 0.0) / SCALE_UNIT_DEG
        self.base_columns.append((f"{MOVE}.gain", MOVE, gain))

    def let_gains_warm(self, temperature_c: FloatArray | None) -> None:
        """Let |accelerometer| follow temperature: all gains that drift alike leave the angle as it is."""
        if temperature_c is not None and np.ptp(temperature_c) > 0.0:
            warmer = (temperature_c - temperature_c.mean()) / np.ptp(temperature_c)
            self.base_columns.append((f"{NORM}.temperature", NORM, warmer))

    def free_first(self) -> None:
        """Free the first pose of each run: the move into it is not known.

        It may have been a long one that had not settled, in the filter or the mount, from either side of the
        backlash or none at all: one pose would then speak for an effect that all the others deny.
        """
        for run in range(self._runs if self.turns else 0):
            first = (self._starts & (self._run_index == run)).astype(float)
            next_move = np.roll(first, 1)  # begins with what the first pose had not settled
            for name, freed in ((READING, first), (ANGLE, first), (MOVE, next_move)):
                if name in self.names:
                    self.base_columns.append((f"{name}.first", name, freed))

    def _begin(self, name: str, values: FloatArray, known: BoolArray, size: float) -> None:
        self.sizes.append(size)
        self.names.append(name)
        self.values.append(values)
        self.known.append(known)

    def base(self) -> FloatArray:
        """Return (n, J, p) the columns of bias and scale, in the order of `base_columns`."""
        stacked = np.zeros((len(self._theta), len(self.names), len(self.base_columns)))
        for k, (_, channel, column) in enumerate(self.base_columns):
            stacked[:, self.names.index(channel), k] = column
        return stacked


def add_witnesses(
    table: Channels, poses: Sequence[Pose], theta: FloatArray, move: FloatArray, starts: BoolArray
) -> None:
    """Add the witnesses that all poses have: accelerometer, gyro over the moves, the stage's own report.

    `table` has the reading. Elevations `theta` and moves `move` into the n poses are (n,), degrees; `starts`
    (n,) tells whether a pose follows on nothing.
    """
    x, y, z = (column_of(poses, f"accel_{axis}_g") for axis in "xyz")
    if y is not None and z is not None:
        angle = reading_error_deg(theta, np.degrees(np.arctan2(y, z)))
        if not same(angle, table.values[0]) and _left_by_line(theta, angle):
            table.add(ANGLE, angle, turn_size(theta), bias_each_run=False, scaled=True)
        norm = np.sqrt(y**2 + z**2 + (0.0 if x is None else x**2)) - 1.0
        size_g = 1.0 + float(np.abs(norm).max())
        if np.ptp(norm) > len(norm) * np.finfo(np.float64).eps * size_g:
            table.add(NORM, norm, size_g, bias_each_run=True, scaled=False)
            table.let_gains_warm(column_of(poses, "temperature_c"))
    felt = np.array([np.nan if p.gyro_move_deg is None else p.gyro_move_deg for p in poses])
    moves = np.isfinite(felt) & ~starts
    enough = moves.any() and moves.sum() >= 0.8 * (~starts).sum()
    if table.turns and enough and _left_by_line(move[moves], felt[moves]):
        table.add_moves(felt, np.array([pose.settled for pose in poses]))
    if all(pose.stage_deg is not None for pose in poses):
        off = theta - np.array([pose.target_deg for pose in poses])
        if np.ptp(off) > ONE_ANGLE_DEG:
            table.add(STAGE, off, turn_size(theta), bias_each_run=False, scaled=True)


def turn_size(*angles_deg: FloatArray) -> float:
    """Return the largest of some angles, a turn at least: differences of angles are taken modulo 360°."""
    return max(360.0, *(float(np.nanmax(np.abs(angle), initial=0.0)) for angle in angles_deg))


def _left_by_line(x: FloatArray, y: FloatArray) -> bool:
    """Return whether a line leaves anything of y: a witness that it explains exactly was never measured."""
    if np.ptp(x) == 0.0:
        return bool(np.ptp(y) > 0.0)
    along, across = x - x.mean(), y - y.mean()
    left = across - along * (along @ across) / (along @ along)
    return bool(np.abs(left).max() > 1e-9 * max(float(np.abs(x).max()), 1.0))
