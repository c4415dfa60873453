"""A unit's gyro as `true = matrix·(raw − bias − dps_per_g·a)`, in the frame of its accelerometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.gyro_dwells import Dwells, dwells_of
from calrig.calibration.joint.gyro_turns import Turns, turns_of
from calrig.calibration.joint.three_axis_fit import ThreeAxisFit
from calrig.calibration.joint.three_axis_frame import Accelerometer
from calrig.estimation.angles import FloatArray
from calrig.estimation.clock import ClockRate, clock_rate

HOST = "host_time_s"
"""Column: when the pose was taken by the host's clock, beside `time_s` by the board's."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeGyro:
    """What dwells and turns say; None of what they do not tell.

    Attributes:
        dwells, turns: in the sensor's frame.
        matrix: (3, 3) and `matrix_std`, in the accelerometer's frame.
        dps_per_g: (3, 3) and `dps_per_g_std`, likewise.
        clock: of the board's by the host's, where the poses have both times.
    """

    dwells: Dwells | None
    turns: Turns | None
    matrix: FloatArray | None
    matrix_std: FloatArray | None
    dps_per_g: FloatArray | None
    dps_per_g_std: FloatArray | None
    clock: ClockRate | None


def whole_gyro(fit: ThreeAxisFit, unit: int, accelerometer: Accelerometer | None) -> WholeGyro | None:
    """One unit's gyro; None where it has no columns of one."""
    dwells = dwells_of(fit, unit)
    turns = turns_of(fit, unit, dwells)
    if dwells is None and turns is None:
        return None
    turn = np.eye(3) if accelerometer is None else accelerometer.turn
    matrix = matrix_std = per_g = per_g_std = None
    if turns is not None and accelerometer is not None:
        inverse = np.linalg.inv(turns.response)
        matrix = turn @ inverse
        slopes = -np.kron(matrix, inverse.T)  # d(G⁻¹) = −G⁻¹·dG·G⁻¹, row by row
        variance = np.diag(slopes @ turns.covariance @ slopes.T).reshape(3, 3)
        across = np.sqrt((matrix**2).sum(axis=0) - matrix**2) * accelerometer.turn_std_rad
        matrix_std = np.sqrt(variance + across**2)
    if dwells is not None and dwells.told:
        per_g = dwells.dps_per_g @ turn.T
        per_g_std = np.sqrt(dwells.dps_per_g_std**2 @ (turn.T) ** 2)
    return WholeGyro(dwells, turns, matrix, matrix_std, per_g, per_g_std, _clock(fit, unit))


def _clock(fit: ThreeAxisFit, unit: int) -> ClockRate | None:
    """The board's clock by the host's, over all runs of a unit."""
    table, poses = fit.problem.table, fit.problem.of.poses
    board, host = [], []
    for source in range(len(table.sources)):
        rows = np.flatnonzero((table.source == source) & (table.unit == unit))
        times = [(poses[row].time_s, poses[row].covariates.get(HOST)) for row in rows]
        both = np.array([pair for pair in times if None not in pair], dtype=np.float64).reshape(-1, 2)
        if len(both):
            board.append(both[:, 0])
            host.append(both[:, 1])
    return clock_rate(board, host) if board else None
