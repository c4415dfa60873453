"""One error map a rig from all its runs: what its units have in common, summed up as runs come by.

A million runs are no joint solution: what the units themselves have in common is in this mean as well. The
rig's own map (`calrig.analysis.error_map`) is solved for, from its newest runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.calibration.fleet_screen import PackedPoses
from calrig.estimation.angles import FloatArray

FEWEST_UNITS = 3
PLACE_DEG = 1.0
"""Poses closer than this in elevation are taken for one place."""
CAVEAT = "common firmware, a common cable or a common sensor design would look the same"
APPROACHES = 3
MIDDLE = 2**20
"""Stands for a place of 0°, so that no key is below 0; of nearly three thousand turns either way."""
Keys = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MeanMap:
    """Mean residual over units by elevation and approach, with its standard error between units."""

    stage_deg: list[float]
    approach: list[int]
    error_deg: list[float]
    std_deg: list[float]
    units: int
    caveat: str = CAVEAT


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSums:
    """Sums of residuals by rig and unit, elevation and approach.

    Attributes:
        pairs: rig and unit.
        pair: (K,) index into those.
        place: (K,) elevation in steps of `PLACE_DEG` with the approach, as one number that orders both.
        sums, counts: (K,) of the residuals, in degrees.
    """

    pairs: tuple[tuple[str, str], ...]
    pair: Keys
    place: Keys
    sums: FloatArray
    counts: FloatArray


def place_sums(poses: PackedPoses, scale: FloatArray, residual_deg: FloatArray) -> PlaceSums:
    """Those of runs of a known unit on a known rig that turned it.

    Args:
        poses: R runs of N poses.
        scale: (R,) NaN where none is known.
        residual_deg: (N,) what calibration leaves.
    """
    codes: dict[tuple[str, str], int] = {}
    of_run = np.full(len(poses), -1, dtype=np.int64)
    for k, (rig, unit) in enumerate(zip(poses.rigs, poses.units, strict=True)):
        if rig is not None and unit is not None:
            of_run[k] = codes.setdefault((rig, unit), len(codes))
    of_run[np.isnan(scale)] = -1
    pair = np.repeat(of_run, poses.counts)
    approach = np.nan_to_num(poses.columns.get("approach", np.zeros(len(pair))))
    step = np.rint(poses.theta_deg / PLACE_DEG)
    place = (APPROACHES * (step + MIDDLE) + np.sign(approach) + 1).astype(np.int64)
    counts = (pair >= 0) & np.isfinite(residual_deg)
    ones = np.ones(int(counts.sum()))
    return _summed(tuple(codes), pair[counts], place[counts], residual_deg[counts], ones)


def merged(parts: Iterable[PlaceSums]) -> PlaceSums:
    """The sums of several parts together."""
    codes: dict[tuple[str, str], int] = {}
    renamed: list[tuple[Keys, Keys, FloatArray, FloatArray]] = []
    for part in parts:
        new = np.array([codes.setdefault(pair, len(codes)) for pair in part.pairs], dtype=np.int64)
        renamed.append((new[part.pair], part.place, part.sums, part.counts))
    if not renamed:
        nothing = np.empty(0, dtype=np.int64)
        return PlaceSums((), nothing, nothing, np.empty(0), np.empty(0))
    pair, place, sums, counts = (np.concatenate(columns) for columns in zip(*renamed, strict=True))
    return _summed(tuple(codes), pair, place, sums, counts)


def _summed(
    pairs: tuple[tuple[str, str], ...], pair: Keys, place: Keys, sums: FloatArray, counts: FloatArray
) -> PlaceSums:
    """Rows of the same pair and place as one."""
    order = np.argsort(pair * (2 * APPROACHES * MIDDLE) + place)
    pair, place = pair[order], place[order]
    begins = np.flatnonzero(np.diff(pair, prepend=-1) | np.diff(place, prepend=-1)) if len(pair) else order
    if len(pair) == 0:
        return PlaceSums(pairs, pair, place, sums, counts)
    summed, counted = (np.add.reduceat(values[order], begins) for values in (sums, counts))
    return PlaceSums(pairs, pair[begins], place[begins], summed, counted)


def rig_maps(sums: PlaceSums) -> dict[str, MeanMap]:
    """The map of each rig, by name: every unit counts once at each place, however many runs it has."""
    rigs = np.array([rig for rig, _ in sums.pairs])
    names, of_pair = np.unique(rigs, return_inverse=True) if len(rigs) else (rigs, np.empty(0, dtype=np.intp))
    known = np.unique(sums.pair)
    units = np.bincount(of_pair[known], minlength=len(names))
    rig, means = of_pair[sums.pair], sums.sums / np.maximum(sums.counts, 1.0)
    return {
        str(name): _map(sums.place[rig == k], means[rig == k], int(units[k])) for k, name in enumerate(names)
    }


def _map(place: Keys, mean_deg: FloatArray, units: int) -> MeanMap:
    """Of the means of all units (K,) of one rig at each place (K,)."""
    places, inverse, n = np.unique(place, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, mean_deg) / n if len(n) else np.empty(0)
    squares = np.bincount(inverse, (mean_deg - mean[inverse]) ** 2) if len(n) else np.empty(0)
    common = n >= FEWEST_UNITS
    std = [math.sqrt(s / (m - 1) / m) for s, m in zip(squares[common], n[common].tolist(), strict=True)]
    step, approach = np.divmod(places[common], APPROACHES)
    return MeanMap(
        [PLACE_DEG * (k - MIDDLE) for k in step.tolist()],
        [k - 1 for k in approach.tolist()],
        mean[common].tolist(),
        std,
        units,
    )
