"""A gear whose period nobody stated: what the poses leave, against every period that their angles resolve.

A worm's error repeats many times in a turn, beyond the orders that a map has by itself; noise takes it up,
which is honest and tells nobody. The best of all periods is told of if noise would make the best of them as
good in one case of a hundred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from calrig.calibration.joint.least_squares import Fit
from calrig.calibration.joint.problem import OWN
from calrig.calibration.joint.stage_map import HIGHEST_ORDER, TURN_DEG, told_order, widest_gap_deg
from calrig.calibration.joint.whitening import whitened

LEVEL = 0.01
STEPS_A_WAVE = 2.0
"""Orders tried for each that an arc resolves."""


@dataclass(frozen=True, slots=True)
class Gear:
    """A period on the dial and its amplitude, degrees; `p_value` is of the best among all that were tried."""

    period_deg: float
    amplitude_deg: float
    p_value: float


def unstated_gear(fit: Fit) -> Gear | None:
    """What repeats on the dial beyond the map; None where nothing does, or the angles are too sparse."""
    table, rows = fit.problem.table, np.flatnonzero(fit.kept)
    dial_deg = table.dial_deg[rows]
    step = TURN_DEG / (TURN_DEG - widest_gap_deg(dial_deg)) / STEPS_A_WAVE
    orders = np.arange(HIGHEST_ORDER + 1.0, told_order(table.dial_deg), step)
    if not len(orders):
        return None
    by_angle = fit.normal.derivatives[rows][:, :, OWN - 1]
    chain = table.mount[rows] * len(table.sources) + table.source[rows]

    def white(values: np.ndarray) -> np.ndarray:
        return whitened(values, rows, chain, fit.problem.correlation)[0].reshape(2 * len(rows), -1)

    left = white(fit.normal.residuals[rows][:, :, None])[:, 0]
    gains, sizes = np.zeros(len(orders)), np.zeros(len(orders))
    for k, order in enumerate(orders):
        turn = np.radians(order * dial_deg)
        wave = white(by_angle[:, :, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)[:, None, :])
        across = wave.T @ left
        found = np.linalg.lstsq(wave.T @ wave, across, rcond=1e-6)[0]
        gains[k], sizes[k] = across @ found, np.hypot(*found)
    best = int(np.argmax(gains))
    freedom = fit.freedom - 2.0
    ratio = 0.5 * gains[best] / max(fit.freedom * fit.noise**2 - gains[best], 1e-300) * freedom
    p_value = min(len(orders) * float(fdtrc(2.0, freedom, ratio)), 1.0)
    if p_value > LEVEL:
        return None
    return Gear(TURN_DEG / float(orders[best]), math.degrees(sizes[best]), p_value)
