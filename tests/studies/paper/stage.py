"""The figure of calibration: readings as they come on stages of the paper's class, before and after a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.estimation.kalman import KalmanFilter

from .sensor import RATE_HZ, benches, log_of

PAPER_RMS_DEG = 0.26
ACCURACY_DEG, RESOLUTION_DEG = 0.5, 0.5
STAGE_STD_DEG = ACCURACY_DEG / math.sqrt(3.0)
"""Of a rectangular distribution of ± 0.5°."""
ELEVATIONS_DEG = range(-60, 61, 10)
SWEEPS = 4
SETTLE_S, DWELL_S = 1.0, 2.0
VELOCITY_DPS, ACCELERATION_DPS2 = 20.0, 80.0


@dataclass(frozen=True)
class Calibrated:
    """RMS of readings less the stage's angle, and what a line leaves of it, degrees."""

    raw_deg: float
    calibrated_deg: float
    poses: list[Pose]


def runs(count: int, seed: int = 3, resolution_deg: float = 0.0) -> list[Calibrated]:
    """Runs of the paper's sensor, each on a stage of its own: an axis off its scale's centre.

    Args:
        count: stages.
        seed: of stages and noise.
        resolution_deg: the stage stands anywhere within half of it to either side of where it is read.
    """
    rng = np.random.default_rng(seed)
    return [_run(rng, k, resolution_deg) for k in range(count)]


def _run(rng: np.random.Generator, seed: int, resolution_deg: float) -> Calibrated:
    of_turn = complex(*rng.normal(0.0, STAGE_STD_DEG, 2))
    rig = benches(
        RATE_HZ,
        seed,
        mechanics={
            "eccentricity_deg": abs(of_turn),
            "eccentricity_phase_deg": math.degrees(math.atan2(of_turn.imag, of_turn.real)),
        },
    )
    poses, now_s = [], 0.0
    for bench in rig:
        now_s = bench.mechanics.home(0.0, VELOCITY_DPS, ACCELERATION_DPS2).at_s
    for sweep in range(SWEEPS):
        for target_deg in sorted(ELEVATIONS_DEG, reverse=sweep % 2 == 1):
            stands_deg = target_deg + resolution_deg * rng.uniform(-0.5, 0.5)
            for bench in rig:
                arrival_s = bench.mechanics.move(now_s, stands_deg, VELOCITY_DPS, ACCELERATION_DPS2).at_s
            time_s = arrival_s + np.arange(int((SETTLE_S + DWELL_S) * RATE_HZ)) / RATE_HZ
            log = log_of(rig, time_s)
            angle_deg = np.degrees(np.arctan2(log["accel_y_g"], log["accel_z_g"]))
            filtered = KalmanFilter().run(time_s, angle_deg, log["gyro_x_dps"])
            settled = time_s >= arrival_s + SETTLE_S
            reading_deg, approach = float(filtered[settled].mean()), 1 - 2 * (sweep % 2)
            poses.append(Pose(target_deg=float(target_deg), reading_deg=reading_deg, approach=approach))
            now_s = float(time_s[-1]) + 1.0 / RATE_HZ
    result = build_result(poses)
    return Calibrated(result.rms_raw_deg, result.rms_calibrated_deg or math.nan, poses)


def table(fine: list[Calibrated], coarse: list[Calibrated]) -> str:
    """Median and the middle nine tenths over stages read exactly, and to half a degree."""
    rows = ["| | readings as they come | after bias and scale |", "| --- | --- | --- |"]
    rows.append(f"| paper | {PAPER_RMS_DEG:.2f}° | |")
    rows.append(f"| simulated, accuracy of {ACCURACY_DEG}° | {_cells(fine)} |")
    rows.append(f"| and read to {RESOLUTION_DEG}° | {_cells(coarse)} |")
    return "\n".join(rows)


def typical(found: list[Calibrated]) -> Calibrated:
    """The run whose raw figure is the median's neighbour."""
    return sorted(found, key=lambda one: one.raw_deg)[len(found) // 2]


def _cells(found: list[Calibrated]) -> str:
    cells = []
    for values in ([one.raw_deg for one in found], [one.calibrated_deg for one in found]):
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
        cells.append(f"{middle:.2f}° ({low:.2f} to {high:.2f})")
    return " | ".join(cells)
