"""Report the stage map with its uncertainty: over the dial, its harmonics, backlash and mounting angles.

Poses at few dial angles do not show the orders beyond these angles, in any mount: the misfit at an angle is
the same each time, and neither more poses nor another mount average it out. Repeated dwells at one angle
distinguish it from noise (pure error: Draper & Smith, Applied Regression Analysis, 1998, section 2.1).
"""

from dataclasses import dataclass

import numpy as np

from calrig.calibration.separation.lack_of_fit import Gear
from calrig.calibration.separation.least_squares import Fit
from calrig.calibration.separation.solution import Solution
from calrig.calibration.separation.stage_map import (
    TURN_DEG,
    Region,
    basis,
    dial_grid_deg,
    inside_gaps,
    inside_regions,
    local_variance_deg2,
    undetermined_gaps,
)
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.model.solution import Harmonic

FEWEST_REPEATS = 12
"""Degrees of freedom of the pure error, below which it says little."""
LEVEL = 1e-3
SAME_DEG = 3
"""Decimals of a dial's angle that is visited again."""


def common_variance(fit: Fit) -> float:
    """Variance of that misfit at an angle of the dial, rad²; 0 where dwells are not repeated or show none."""
    from scipy.special import fdtrc

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


def covariance_of_misfit(fit: Fit) -> FloatArray:
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


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """The map less its mean over the dial's angles, which goes into the mounts; degrees.

    Attributes:
        stage_deg, error_deg, std_deg: (m,) over the dial where poses stood, as in the middle of the play; NaN
            in a gap.
        orders: of the series; last that of a gear nobody stated, of coefficients 0 and its own variance.
        regions, gaps_deg: where the stage is off locally, and where no pose shows the map.
        mean_deg: of the fit's own series, what was taken off.
        coefficients, covariance: (p,) and (p, p) of cosine and sine of each order, then the play; with what
            poses at one angle of the dial have in common that the orders do not explain.
        backlash: reading after upward moves less that after downward moves, and its standard error.
        mounts_deg, mounts_std_deg: of each mount.
    """

    stage_deg: FloatArray
    error_deg: FloatArray
    std_deg: FloatArray
    orders: tuple[float, ...]
    regions: tuple[Region, ...]
    gaps_deg: tuple[tuple[float, float], ...]
    mean_deg: float
    coefficients: FloatArray
    covariance: FloatArray
    harmonics: tuple[Harmonic, ...]
    backlash: tuple[float, float] | None
    mounts_deg: FloatArray
    mounts_std_deg: FloatArray


def mapped(solution: Solution) -> Mapped:
    """The map and the mounts of a joint solution."""
    fit = solution.fit
    problem, at = fit.problem, fit.problem.map_at
    visited = problem.table.dial_deg[fit.kept | inside_regions(problem.table.dial_deg, solution.regions)]
    gaps = undetermined_gaps(visited)
    dial = dial_grid_deg(visited)
    columns = basis(dial, np.zeros(len(dial)), problem.orders)
    if gaps:
        dial = np.union1d(dial, visited[(visited >= dial[0]) & (visited <= dial[-1])])
        columns = basis(dial, np.zeros(len(dial)), problem.orders)
    unknown = inside_gaps(dial, gaps)
    mean = columns[~unknown].mean(axis=0)
    coefficients = np.degrees(fit.parameters[at])
    of_fit = fit.covariance_at(np.arange(fit.problem.size)[at]) + covariance_of_misfit(fit)
    covariance = np.degrees(np.degrees(of_fit))
    variance = np.einsum("gi,ij,gj->g", columns - mean, covariance, columns - mean)
    variance = np.maximum(variance, 0.0) + local_variance_deg2(solution.regions, dial)
    if solution.gear is not None:
        variance += 0.5 * solution.gear.amplitude_deg**2
    mounts = np.zeros((len(problem.table.mounts), problem.size))
    mounts[:, problem.mounts_at] = np.eye(len(mounts))
    mounts[:, at] = mean
    of_mounts = np.diag(fit.covariance_of(mounts))
    noise_deg = float(np.degrees(fit.noise))
    play = float(coefficients[-1]), float(np.sqrt(max(covariance[-1, -1], 0.0)))
    orders, series, whole = _with_gear(problem.orders, coefficients, covariance, solution.gear)
    return Mapped(
        stage_deg=dial,
        error_deg=np.where(unknown, np.nan, (columns - mean) @ coefficients),
        std_deg=np.where(unknown, np.nan, np.sqrt(variance)),
        orders=orders,
        regions=solution.regions,
        gaps_deg=gaps,
        mean_deg=float(mean @ coefficients),
        coefficients=series,
        covariance=whole,
        harmonics=tuple(
            _harmonic(order, coefficients[k : k + 2], covariance[k : k + 2, k : k + 2], noise_deg)
            for k, order in zip(range(0, 2 * len(problem.orders), 2), problem.orders, strict=True)
        ),
        backlash=play if problem.free[-1] else None,
        mounts_deg=wrap_deg(np.degrees(mounts @ fit.parameters)),
        mounts_std_deg=np.degrees(np.sqrt(np.maximum(of_mounts, 0.0))),
    )


def _with_gear(
    orders: tuple[float, ...], coefficients: FloatArray, covariance: FloatArray, gear: Gear | None
) -> tuple[tuple[float, ...], FloatArray, FloatArray]:
    """The series with a wave of unknown phase for a gear nobody stated: coefficients of 0, and its variance.

    Of a whole order, so that the map stays one of the turn; the variance has no phase.
    """
    if gear is None:
        return orders, coefficients, covariance
    n = len(coefficients) - 1
    longer = np.concatenate([coefficients[:n], [0.0, 0.0], coefficients[n:]])
    wider = np.zeros((n + 3, n + 3))
    own = np.r_[np.arange(n), n + 2]
    wider[np.ix_(own, own)] = covariance
    wider[n, n] = wider[n + 1, n + 1] = 0.5 * gear.amplitude_deg**2
    return (*orders, float(round(TURN_DEG / gear.period_deg))), longer, wider


def _harmonic(order: float, pair: FloatArray, covariance: FloatArray, noise_deg: float) -> Harmonic:
    """Of cosine and sine; the standard error is that of the wave, root mean square over its phase."""
    std_deg = float(np.sqrt(max(0.5 * np.trace(covariance), 0.0)))
    phase_deg = float(np.degrees(np.arctan2(pair[0], pair[1]))) % TURN_DEG
    return Harmonic(
        order=float(order),
        amplitude_deg=float(np.hypot(*pair)),
        phase_deg=phase_deg,
        std_deg=std_deg,
        separable=std_deg < noise_deg,
    )
