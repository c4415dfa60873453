"""Fleets: runs by the simulator's physics, each of them many times over with noise of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calrig.calibration.fleet_screen import screen
from calrig.calibration.packed_poses import PackedPoses, packed
from calrig.calibration.poses import Pose
from studies.blind.cells import CELLS
from studies.blind.physics import Noise

SILENT = Noise(reading_deg=0.0, norm_mg=0.0, move_deg=0.0)
OF_THE_SCREEN = (
    *("target_deg", "reading_deg", "approach", "time_s", "temperature_c", "stage_deg"),
    *("accel_y_g", "accel_z_g"),
)
UNITS, RIGS = 20_000, 40
RUNS_A_PIECE = 10_000


def fleet(n_runs: int, seed: int, first: int = 0, *, cell: str = "null white") -> PackedPoses:
    """Runs of a cell of the blind board: its first seeds free of noise, then noise drawn for each run.

    Args:
        n_runs: how many.
        seed: of the noise.
        first: number of the first one; units and rigs go round by it.
        cell: as in `blind.cells`.
    """
    rng = np.random.default_rng([seed, first])
    made = packed({str(k): _silent(cell, k) for k in range(min(n_runs, 20))})
    chosen = made.runs(np.arange(n_runs) % len(made))
    n = int(made.counts[0])
    drawn = np.concatenate([CELLS[cell].noise.draw(rng, n) for _ in range(n_runs)])
    columns = {name: np.array(chosen.columns[name]) for name in OF_THE_SCREEN}
    columns["reading_deg"] += drawn[:, 0]
    angle = np.arctan2(columns["accel_y_g"], columns["accel_z_g"]) + np.radians(drawn[:, 1])
    norm = np.hypot(columns["accel_y_g"], columns["accel_z_g"]) * (1.0 + drawn[:, 2])
    columns["accel_y_g"], columns["accel_z_g"] = norm * np.sin(angle), norm * np.cos(angle)
    columns["temperature_c"] += rng.normal(0.0, 0.01, len(angle))
    numbers = range(first, first + n_runs)
    units = tuple(f"U{k % UNITS:05}" for k in numbers)
    rigs = tuple(f"bench-{k % RIGS}" for k in numbers)
    return PackedPoses(tuple(f"run-{k:07}" for k in numbers), chosen.first, columns, units, rigs)


def screened_again(times: int) -> tuple[int, int]:
    """Screens one piece so many times: runs screened, and those that stood out."""
    piece = fleet(RUNS_A_PIECE, 2)
    stood_out = sum(int(np.count_nonzero(screen(piece).stands_out)) for _ in range(times))
    return times * len(piece), stood_out


def _silent(name: str, seed: int) -> list[Pose]:
    return replace(CELLS[name], noise=SILENT).run(seed).poses
