"""The joint solution: outliers, the map's orders, the fit, and whether the data part stage and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.lack_of_fit import MountTest, mount_tests
from calrig.calibration.separation.least_squares import (
    Fit,
    correlation_of,
    distances,
    fitted,
    without_outliers,
)
from calrig.calibration.separation.level import ElevationUncertainty, Level, level_of, worth
from calrig.calibration.separation.mounts import outliers_said, table_of
from calrig.calibration.separation.order_choice import Choice, always, chosen, offered
from calrig.calibration.separation.pose_table import MountedPoses, Table
from calrig.calibration.separation.problem import Problem
from calrig.calibration.separation.stage_map import TURN_DEG

FEWEST_SPARE = 8
"""Responses beside the parameters, which the noise is found from."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Stage map, mounts and units of some poses.

    Attributes:
        fit: of the model that the data carry.
        choice: how that model was chosen.
        worths: of each unit's calibrated elevation less its mean over the range.
        levels: of each unit that was reversed.
        mount_tests: each mount against the others.
        warnings: what a person should know of the poses.
    """

    fit: Fit
    choice: Choice
    worths: tuple[ElevationUncertainty, ...]
    levels: tuple[Level | None, ...]
    mount_tests: tuple[MountTest, ...]
    warnings: tuple[str, ...]

    @property
    def table(self) -> Table:
        """The poses."""
        return self.fit.problem.table

    @property
    def noise_deg(self) -> float:
        """Standard deviation of one pose's angle."""
        return float(np.degrees(self.fit.noise))

    def known_level(self, unit: int) -> Level | None:
        """The level of a unit, where it is known how well."""
        level = self.levels[unit]
        return level if level is not None and level.is_known else None

    def measurand(self, unit: int) -> ElevationUncertainty:
        """What documents say of an elevation: of the whole where the level is known, else less its mean."""
        level = self.known_level(unit)
        return self.worths[unit] if level is None else worth(self.fit, unit, level)

    def is_separable(self, unit: int) -> bool:
        """Whether a unit's elevation is known better than a single pose is measured.

        Where it is not, some hundred poses together say less than one: they do not part unit and stage.
        """
        return self.worths[unit].rms_deg < self.noise_deg


def solve(
    lots: Sequence[MountedPoses],
    *,
    linear: bool = False,
    periods_deg: Sequence[float] = (),
    seat_std_deg: float | None = None,
    progress: Progress = unheard,
) -> Solution:
    """Solves stage, mounts and units at once.

    Args:
        lots: poses of each clamping, of one stage.
        linear: whether the units are stated to have no quadratic and cubic terms.
        periods_deg: of gears, where somebody knows them.
        seat_std_deg: how far one clamping scatters from the next on the same seat, where somebody knows it.
        progress: is told the share that is done.

    Raises:
        DiagnosisError: the poses are too few, or cannot be what they are said to be.
    """
    table, warnings = table_of(lots)
    return solve_table(
        table,
        linear=linear,
        periods_deg=periods_deg,
        seat_std_deg=seat_std_deg,
        warnings=warnings,
        progress=progress,
    )


def solve_table(
    table: Table,
    *,
    linear: bool = False,
    periods_deg: Sequence[float] = (),
    seat_std_deg: float | None = None,
    warnings: Sequence[str] = (),
    progress: Progress = unheard,
) -> Solution:
    """The same of poses in columns."""
    known = [TURN_DEG / period for period in periods_deg]
    problem = Problem(table, always(linear, known), linear)
    orders = offered(problem, int((1 + table.has_vector).sum()), FEWEST_SPARE)
    rich, weights = without_outliers(replace(problem, orders=orders))
    progress(0.5)
    correlated = replace(rich.problem, correlation=correlation_of(rich))
    progress(0.7)
    choice = chosen(fitted(correlated, weights, rich.parameters), known)
    fit = fitted(replace(correlated, orders=choice.orders), weights)
    progress(0.85)
    units = range(len(table.units))
    levels = tuple(level_of(fit, unit, seat_std_deg) for unit in units)
    if seat_std_deg is not None and not any(levels):
        warnings = [*warnings, "a seat-std was stated, and no unit was clamped both ways round on one seat"]
    return Solution(
        fit=fit,
        choice=choice,
        worths=tuple(worth(fit, unit) for unit in units),
        levels=levels,
        mount_tests=tuple(mount_tests(fit)),
        warnings=(*warnings, *outliers_said(table, fit.kept, distances(fit))),
    )
