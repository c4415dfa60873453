"""What poses at one dial angle have in common and no parameter explains: the map beyond its orders.

Poses that were taken to few angles of the dial do not show orders beyond them, in any mount: the misfit is
the same each time, and neither more poses nor another mount average it out. Dwells that are repeated at one
angle tell it from noise (pure error: Draper & Smith, Applied Regression Analysis, 1998, section 2.1).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.special import fdtrc

from calrig.calibration.joint.linearised import Linearised
from calrig.calibration.joint.stage_map import basis
from calrig.estimation.angles import FloatArray

FEWEST_REPEATS = 12
"""Degrees of freedom of the pure error, below which it says little."""
LEVEL = 1e-3
SAME_DEG = 3
"""Decimals of a dial's angle that is visited again."""


class Residuals(Linearised, Protocol):
    """A fit, and what it leaves of each pose's angle."""

    def left(self) -> FloatArray:
        """(n,) rad."""


def common_variance(fit: Residuals) -> float:
    """Variance of that misfit at an angle of the dial, rad²; 0 where dwells are not repeated or show none."""
    table = fit.problem.table
    rows = np.flatnonzero(fit.kept)
    left, dial = fit.left()[rows], np.round(table.dial_deg[rows], SAME_DEG)
    visits = np.column_stack([dial, table.mount[rows], table.approach[rows]])
    _, visit, revisits = np.unique(visits, axis=0, return_inverse=True, return_counts=True)
    visit = visit.ravel()
    mean = np.bincount(visit, left) / revisits
    repeats = len(left) - len(revisits)
    if repeats < FEWEST_REPEATS:
        return 0.0
    pure = float(np.sum((left - mean[visit]) ** 2)) / repeats
    _, angle, poses = np.unique(dial, return_inverse=True, return_counts=True)
    common = np.bincount(angle.ravel(), left) / poses
    between = float(np.sum(poses * common**2)) / len(poses)
    if pure == 0.0 or fdtrc(len(poses), repeats, between / pure) > LEVEL:
        return 0.0
    return max(float(np.mean(common**2 - pure / poses)), 0.0)


def covariance_of_misfit(fit: Residuals) -> FloatArray:
    """(p, p) of the map's coefficients, rad²: as wide over the angles visited as what is common there."""
    variance = common_variance(fit)
    orders = fit.problem.orders
    width = 2 * len(orders) + 1
    if variance == 0.0:
        return np.zeros((width, width))
    dial = np.unique(np.round(fit.problem.table.dial_deg[fit.kept], SAME_DEG))
    columns = basis(dial, np.zeros(len(dial)), orders)
    gram = columns.T @ columns
    share = len(dial) / np.linalg.matrix_rank(gram, hermitian=True)
    return np.asarray(variance * share * np.linalg.pinv(gram, rcond=1e-9, hermitian=True), dtype=np.float64)
