"""The joint solution: outliers, the map's orders, the fit, and whether the data part stage and units."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.lack_of_fit import (
    Gear,
    MountTest,
    mount_tests,
    unstated_gear,
    vibrating_at_deg,
)
from calrig.calibration.separation.least_squares import (
    OUTLIER_STD,
    Fit,
    correlation_of,
    distances,
    fitted,
    with_noise_of_components,
    without_outliers,
)
from calrig.calibration.separation.level import Level, level_of
from calrig.calibration.separation.local_errors import without_regions
from calrig.calibration.separation.order_choice import Choice, always, chosen, offered
from calrig.calibration.separation.pose_table import MountedPoses, Table, table_of
from calrig.calibration.separation.problem import PLAIN, Problem
from calrig.calibration.separation.spread import spread_of
from calrig.calibration.separation.stage_map import TURN_DEG, Region, inside_regions
from calrig.calibration.separation.unit_results import (
    ElevationUncertainty,
    InPlane,
    elevation_uncertainty,
    in_plane,
)
from calrig.estimation.angles import BoolArray, wrap_deg

MOST_TILT_DEG = 25.0
"""Of an axis that was stated to lie along the stage's."""
HARDLY_NOISE = 0.85
"""Correlation from pose to pose, seconds apart, beyond which something else moved."""
SHAKEN_DEG = 10.0
"""Of the dial, to either side of where a stage vibrates, poses are left out."""
MOST_NAMED = 5
"""Of the poses that were left out, how many are named."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Stage map, mounts and units of some poses.

    Attributes:
        fit: of the model that the data carry.
        choice: how that model was chosen.
        planes: each unit about its x axis.
        uncertainties: of each unit's calibrated elevation less its mean over the range.
        levels: of each unit that was reversed.
        mount_tests: each mount against the others, of units in the plane.
        warnings: of how the poses were taken, and those that were left out.
        regions: of the dial where the stage is off locally; their poses are left out of the fit.
        gear: a period on the dial that nobody stated; None without one.
    """

    fit: Fit
    choice: Choice
    planes: tuple[InPlane, ...]
    uncertainties: tuple[ElevationUncertainty, ...]
    levels: tuple[Level | None, ...]
    mount_tests: tuple[MountTest, ...]
    warnings: tuple[str, ...]
    regions: tuple[Region, ...] = ()
    gear: Gear | None = None

    @property
    def table(self) -> Table:
        """The poses."""
        return self.fit.problem.table

    @property
    def noise_deg(self) -> float:
        """Standard deviation of one pose's angle."""
        return float(np.degrees(self.fit.noise))

    @property
    def are_separable(self) -> bool:
        """Whether the elevation of every unit is."""
        return all(self.is_separable(unit) for unit in range(len(self.table.units)))

    def known_level(self, unit: int) -> Level | None:
        """The level of a unit, where it is known how well."""
        level = self.levels[unit]
        return level if level is not None and level.is_known else None

    def measurand(self, unit: int) -> ElevationUncertainty:
        """What documents say of an elevation: of the whole where the level is known, else less its mean."""
        level = self.known_level(unit)
        if level is None:
            return self.uncertainties[unit]
        return elevation_uncertainty(self.fit, unit, self.planes[unit], level)

    def is_separable(self, unit: int) -> bool:
        """Whether a unit's elevation is known better than a single pose is measured.

        Where it is not, some hundred poses together say less than one: they do not part unit and stage.
        """
        return self.uncertainties[unit].rms_deg < self.noise_deg


def solve(
    lots: Sequence[MountedPoses],
    *,
    linear: bool = False,
    periods_deg: Sequence[float] = (),
    seat_std_deg: float | None = None,
    progress: Progress = unheard,
) -> Solution:
    """Solve stage, mounts and units at once.

    Args:
        lots: poses of each clamping, of one stage.
        linear: whether the units are stated to have no quadratic and cubic terms.
        periods_deg: of gears, as far as they are known.
        seat_std_deg: repeatability of one clamping to the next on one seat, if it is known; only for units
            in the plane.
        progress: callback, called with the share that is done.

    Raises:
        DiagnosisError: the poses are too few, or cannot be what they are said to be.
    """
    table, warnings = table_of(lots)
    known = [TURN_DEG / period for period in periods_deg]
    problem = Problem(table, always(linear, known), linear)
    rich, weights = without_outliers(replace(problem, orders=offered(problem)))
    progress(0.5)
    if table.is_whole:
        rich = with_noise_of_components(rich)
    progress(0.7)
    rich = _with_correlation(rich)
    shaken = np.zeros(len(table), dtype=np.bool_)
    if (at_deg := vibrating_at_deg(rich)) is not None:
        shaken = np.abs(wrap_deg(table.dial_deg - at_deg)) < SHAKEN_DEG
        warnings = [
            *warnings,
            f"|a| is off in neighbouring poses near {at_deg:g}° of the dial, as where a stage vibrates: the "
            f"{int((shaken & rich.kept).sum())} poses within {SHAKEN_DEG:g}° of it were left out",
        ]
        weights = np.where(shaken, 0.0, rich.weights)
        rich = _with_correlation(fitted(rich.problem, weights, rich.parameters))
    choice, plain, regions = _plain(rich, known)
    fit = _with_spread(plain)
    progress(0.85)
    _refuse_another_face(fit)
    units, in_the_plane = range(len(table.units)), not table.is_whole
    levels = tuple(level_of(fit, unit, seat_std_deg) if in_the_plane else None for unit in units)
    if seat_std_deg is not None and in_the_plane and not any(levels):
        warnings = [*warnings, "a seat-std was stated, and no unit was clamped both ways round on one seat"]
    planes = tuple(in_plane(fit, unit) for unit in units)
    return Solution(
        fit=fit,
        choice=choice,
        planes=planes,
        uncertainties=tuple(elevation_uncertainty(fit, unit, planes[unit]) for unit in units),
        levels=levels,
        mount_tests=tuple(mount_tests(plain)) if in_the_plane else (),
        warnings=(*warnings, *_outlier_messages(fit, regions, shaken)),
        regions=regions,
        gear=unstated_gear(fit) if in_the_plane else None,
    )


def _with_correlation(fit: Fit) -> Fit:
    problem = replace(fit.problem, correlation=correlation_of(fit))
    return fitted(problem, fit.weights, fit.parameters)


def _plain(rich: Fit, known: Sequence[float]) -> tuple[Choice, Fit, tuple[Region, ...]]:
    """The orders that the data carry, the model with these, and the regions whose poses are left out."""
    again, _, regions = without_regions(rich, rich.weights)
    if regions:
        rich = _with_correlation(again)
    choice = chosen(rich, known)
    fit = fitted(replace(rich.problem, orders=choice.orders), rich.weights)
    if not regions:  # many orders may follow a small one that few do not
        _, weights, regions = without_regions(fit, rich.weights)
        if regions:
            rich = _with_correlation(fitted(rich.problem, weights, rich.parameters))
            choice = chosen(rich, known)
            fit = fitted(replace(rich.problem, orders=choice.orders), weights)
    return choice, fit, regions


def _with_spread(plain: Fit) -> Fit:
    """The same fit with what differs between mounts, and quartic terms, as far as the poses show them."""
    if plain.problem.correlation > HARDLY_NOISE:
        return plain
    spread = spread_of(plain)
    if spread == PLAIN:
        return plain
    problem = replace(plain.problem, spread=spread, correlation=0.0)
    again = correlation_of(fitted(problem, plain.weights, plain.parameters))
    plain = fitted(replace(plain.problem, correlation=again), plain.weights, plain.parameters)
    return fitted(replace(plain.problem, spread=spread_of(plain)), plain.weights, plain.parameters)


def _refuse_another_face(fit: Fit) -> None:
    table = fit.problem.table
    for mount, named in enumerate(table.mounts):
        tilts = fit.parameters[fit.problem.tilts_at(mount)]
        tilt_deg = float(np.degrees(np.abs(tilts).max(initial=0.0)))
        if tilt_deg > MOST_TILT_DEG:
            raise DiagnosisError(
                f"mount {named.name} of unit {table.units[named.unit]}: mount_axis is {named.axis}, but that "
                f"axis lies {tilt_deg:.0f}° from the stage's"
            )


def _outlier_messages(fit: Fit, regions: Sequence[Region], shaken: BoolArray) -> list[str]:
    """Poses that were left out, each by its place; and how many lie as far off and were not."""
    table, messages = fit.problem.table, []
    left_out = np.flatnonzero(~fit.kept & ~inside_regions(table.dial_deg, regions) & ~shaken)
    if len(left_out):
        listed = ", ".join(
            f"{table.mounts[table.mount[k]].name} at {table.dial_deg[k]:g}°" for k in left_out[:MOST_NAMED]
        )
        messages.append(f"{len(left_out)} outliers were left out: {listed}")
    far = int((distances(fit)[fit.kept] > OUTLIER_STD).sum())
    if far:
        messages.append(f"{far} poses lie far from the model, too many to be left out: something else moved")
    return messages
