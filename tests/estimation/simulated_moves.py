"""Logs of a sensor on a stage that moves and stands, straight from the simulator's physics."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

RATE_HZ = 200.0
FIRST_REST_S, REST_S = 5.0, 3.0
SWEEP_DEG = (*range(10, 61, 10), *range(50, -61, -10), *range(-50, 1, 10))

WHITE_ELEVATION = math.degrees(400e-6) / math.sqrt(2.0)
WHITE_GYRO = 0.005 / math.sqrt(2.0)
"""The simulated chip's white noise as an Allan deviation gives it: one-sided densities over √2."""


class MovesLog(NamedTuple):
    time_s: np.ndarray
    elevation_deg: np.ndarray
    rate_dps: np.ndarray
    true_deg: np.ndarray
    moves_s: np.ndarray


def moves_log(targets_deg=SWEEP_DEG, *, velocity_dps=20.0, acceleration_dps2=80.0, **options) -> MovesLog:
    """A log of a stage that rests, then goes to each target and rests; moves_s (m, 2) are begins and ends."""
    bench = Bench(SimulatorSettings.from_options(options))
    begin_s = now_s = bench.mechanics.home(0.0, 20.0, 80.0).at_s
    now_s += FIRST_REST_S
    moves = []
    for target_deg in targets_deg:
        arrival_s = bench.mechanics.move(now_s, target_deg, velocity_dps, acceleration_dps2).at_s
        moves.append((now_s, arrival_s))
        now_s = arrival_s + REST_S
    time_s = begin_s + np.arange(int((now_s - begin_s) * RATE_HZ)) / RATE_HZ
    counts = bench.counts(time_s, RATE_HZ).astype(float)
    return MovesLog(
        time_s,
        np.degrees(np.arctan2(counts[:, 1], counts[:, 2])),
        counts[:, 4] * 250.0 / 32768.0,
        bench.sensor(time_s).angle_deg,
        np.array(moves),
    )
