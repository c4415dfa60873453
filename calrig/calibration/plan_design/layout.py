"""Where the poses of a design stand, and in which order they are visited."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calrig.calibration.plan_design.rig_figures import Pace
from calrig.estimation.angles import FloatArray

CLUSTER = 0.1
"""Share of the range within which poses at an end stand: each needs a move of its own before it."""
DECIMALS = 2


def layout(
    range_deg: tuple[float, float], n_poses: int, sweeps: int, at_ends: float, rng: np.random.Generator
) -> list[float]:
    """Elevations in the order of visiting.

    Places spread evenly but for a share that stands near the ends, where they say most of the scale; each
    is drawn within its own interval, so that no period hides in a grid. Every sweep visits places of its own,
    drawn at random, upward and downward in turn: the way stays short, and moves are of all lengths, in both
    senses at neighbouring places.

    Args:
        range_deg: lowest and highest elevation; both are visited.
        n_poses: how many, at least 2 a sweep.
        sweeps: how often the range is gone through.
        at_ends: share of the poses near the ends, 0 to 1.
        rng: draws places and sweeps.
    """
    low, high = range_deg
    within = rng.uniform(0.0, 1.0, n_poses)
    within[0], within[-1] = 0.0, 1.0
    places = _placed((np.arange(n_poses) + within) / n_poses, at_ends)
    elevations = np.round(low + (high - low) * places, DECIMALS)
    of_sweep = rng.permutation(np.arange(n_poses) % sweeps)
    of_sweep[0] = of_sweep[-1] = 0  # the ends first: a run that is cut short has the line
    order: list[float] = []
    for sweep in range(sweeps):
        own = np.sort(elevations[of_sweep == sweep])
        order += (own if sweep % 2 == 0 else own[::-1]).tolist()
    return order


def _placed(share: FloatArray, at_ends: float) -> FloatArray:
    """(n,) place in the range, 0 to 1, of a share of the poses: quantiles of ends and middle mixed."""
    inverse = np.linspace(0.0, 1.0, 1001)
    near_an_end = 0.5 * (np.clip(inverse / CLUSTER, 0, 1) + np.clip((inverse - 1.0) / CLUSTER + 1.0, 0, 1))
    below = at_ends * near_an_end + (1.0 - at_ends) * inverse
    return np.asarray(np.interp(share, below + 1e-9 * inverse, inverse), dtype=np.float64)


def way_s(elevations_deg: list[float], pace: Pace) -> float:
    """Time of all moves, from the first pose on."""
    return sum(pace.travel_s(abs(after - before)) for before, after in pairwise(elevations_deg))


BEST_OVER_RANGE = 4.0 / 3.0
"""Of n poses at the two ends, times n: no layout has less variance in the mean over the range."""


def leverage(elevations_deg: list[float]) -> tuple[float, float, float]:
    """Of a line through poses of scatter 1: variance of elevation (mean over the range), bias, scale."""
    theta = np.array(elevations_deg)
    design = np.column_stack([np.ones(len(theta)), theta])
    covariance = np.linalg.inv(design.T @ design)
    low, high = theta.min(), theta.max()
    mean, mean_square = (low + high) / 2.0, (low * low + low * high + high * high) / 3.0
    over_range = covariance[0, 0] + 2.0 * mean * covariance[0, 1] + mean_square * covariance[1, 1]
    return float(over_range), float(covariance[0, 0]), float(covariance[1, 1])
