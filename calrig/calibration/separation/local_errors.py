"""Find local errors of the stage: dial angles where neighbouring poses are off together (a damaged tooth).

A pose that is off alone is an outlier. If its neighbours on the dial are off with it, in any mount, the stage
is off there, and a series of low orders does not describe it. The residuals of neighbouring poses are added
up in windows of the dial, each limited to a few standard deviations so that no pose alone makes a region, and
tested against noise with Bonferroni's bound over all windows. The poses of a region are left out of the fit,
and the map's standard deviation there is the largest residual seen.
"""

import math
from collections.abc import Sequence

import numpy as np

from calrig.calibration.separation.least_squares import Fit, fitted
from calrig.calibration.separation.pose_table import GROSS_G, Table
from calrig.calibration.separation.stage_map import MARGIN_DEG, TURN_DEG, Region
from calrig.estimation.angles import BoolArray, FloatArray, robust_std, wrap_deg

WINDOWS_DEG = (0.02, 0.5, 1.0, 2.0, 4.0)
LEVEL = 0.01
"""Chance that noise alone makes any region."""
MOST_OF_ONE = 3.5
"""Standard deviations that one pose counts at most."""
OFF = 2.0
"""Standard deviations from which on a pose's surroundings belong to a region."""
WIDEST_DEG = 12.0
MOST_SHARE = 0.25
"""Of the poses in regions; beyond, or in a wider region, the misfit is not local."""
ROUNDING_DEG = 1e-9
"""Of an angle that was taken onto the turn."""
FEWEST_POSES = 24
ROUNDS = 3
ALONE_DEG, ALONE = 0.3, 4.5
"""A pose off by so many standard deviations may be the stage's where no pose so near contradicts it."""
ROOM = 0.2
"""Least share of a pose's variance that the fit is taken to leave in its residual."""


def without_regions(fit: Fit, weights: FloatArray) -> tuple[Fit, FloatArray, tuple[Region, ...]]:
    """Return the fit without the poses of local errors, its weights (n,), and the regions.

    The fit is of any model of the map; `weights` (n,) are 0 of outliers.
    """
    table = fit.problem.table
    if len(table) < FEWEST_POSES:
        return fit, weights, ()
    inside, best = np.zeros(len(table), dtype=np.bool_), fit
    for _ in range(ROUNDS):
        cores = _cores(table, _residuals(best), fit.problem.correlation)
        now = _within(table.dial_deg, cores, MARGIN_DEG)
        if not _are_local(cores, now):
            return fit, weights, ()
        own = np.where(now, 0.0, weights)
        if (now == inside).all():
            break
        inside = now
        best = fitted(fit.problem, own, fit.parameters)
    if not cores:
        return fit, weights, ()
    off_deg = np.abs(np.degrees(best.left()))
    gross = np.abs(table.size_g - 1.0) > GROSS_G
    found = tuple(
        Region(low, high, float(off_deg[_within(table.dial_deg, [(low, high)], 0.0) & ~gross].max()))
        for low, high in cores
    )
    return best, np.where(inside, 0.0, weights), found


def _residuals(fit: Fit) -> FloatArray:
    """(n,) residual angles in standard deviations."""
    left, share = fit.left(), fit.leverage().max(axis=1)
    kept = fit.kept
    noise = max(robust_std(left[kept]), 1e-12)
    room = np.where(kept, np.clip(1.0 - share, ROOM, 1.0), 1.0 + np.maximum(share, 0.0))
    return np.asarray(left / (noise * np.sqrt(room)))


def _cores(table: Table, residuals: FloatArray, rho: float) -> list[tuple[float, float]]:
    """First and last dial angle of the poses of each region; one through the turn's end goes on beyond it."""
    from scipy.special import ndtri

    gross = np.abs(table.size_g - 1.0) > GROSS_G
    rows = np.flatnonzero(~gross)
    begin_deg = table.dial_deg[rows].min()
    on_turn_deg = begin_deg + np.mod(table.dial_deg[rows] - begin_deg, TURN_DEG)
    order = np.argsort(on_turn_deg, kind="stable")
    rows, dial = rows[order], on_turn_deg[order]
    z, n = residuals[rows], len(rows)
    rows, dial = np.tile(rows, 2), np.concatenate([dial, dial + TURN_DEG])  # windows go on beyond the turn
    limited = np.clip(residuals[rows], -MOST_OF_ONE, MOST_OF_ONE)
    chain = table.mount[rows] * len(table.sources) + table.source[rows]
    limit = -float(ndtri(0.5 * LEVEL / (n * len(WINDOWS_DEG))))
    bad = np.zeros(2 * n, dtype=np.bool_)
    for width in WINDOWS_DEG:
        last = np.searchsorted(dial, dial[:n] + width, side="right")
        for first, end in enumerate(last.tolist()):
            if end - first < 2:
                continue
            own = slice(first, end)
            total = float(limited[own].sum())
            if abs(total) > limit * math.sqrt(end - first) and abs(total) > limit * math.sqrt(
                _variance(rows[own], chain[own], rho)
            ):
                bad[own] |= limited[own] * math.copysign(1.0, total) > OFF
    angles = dial[:n][bad[:n] | bad[n:] | _uncontradicted(dial[:n], z)]
    if not len(angles):
        return []
    ends = np.flatnonzero(np.diff(angles) > 2.0 * MARGIN_DEG)
    lows, highs = angles[np.r_[0, ends + 1]].tolist(), angles[np.r_[ends, len(angles) - 1]].tolist()
    if len(lows) > 1 and lows[0] + TURN_DEG - highs[-1] <= 2.0 * MARGIN_DEG:
        highs[-1] = highs.pop(0) + TURN_DEG
        del lows[0]
    return list(zip(lows, highs, strict=True))


def _variance(rows: np.ndarray, chain: np.ndarray, rho: float) -> float:
    """Of the sum of standardised noise that is correlated from one pose of a chain to the next."""
    if rho <= 0.0:
        return float(len(rows))
    apart = np.abs(rows[:, None] - rows)
    return float((rho**apart * (chain[:, None] == chain)).sum())


def _uncontradicted(dial_deg: FloatArray, z: FloatArray) -> BoolArray:
    """(n,) whether a pose is far off and none near it on the dial is less than half as far off."""
    found = np.zeros(len(z), dtype=np.bool_)
    for k in np.flatnonzero(np.abs(z) > ALONE):
        found[k] = not (
            np.abs(wrap_deg(dial_deg - dial_deg[k]))[z * np.sign(z[k]) < 0.5 * abs(z[k])] <= ALONE_DEG
        ).any()
    return found


def _within(dial_deg: FloatArray, cores: Sequence[tuple[float, float]], margin_deg: float) -> BoolArray:
    found = np.zeros(len(dial_deg), dtype=np.bool_)
    for low, high in cores:
        before_deg = margin_deg + ROUNDING_DEG
        found |= np.mod(dial_deg - low + before_deg, TURN_DEG) <= high - low + 2.0 * before_deg
    return found


def _are_local(cores: Sequence[tuple[float, float]], inside: BoolArray) -> bool:
    widest = max((high - low for low, high in cores), default=0.0)
    return widest <= WIDEST_DEG and float(np.mean(inside)) <= MOST_SHARE
