"""Steady sinusoids that stand out of the noise of a log, found and taken out one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.noise.peaks import LOWEST, candidates, excess
from calrig.noise.periodogram import Gridded

SIGNIFICANCE = 0.001
"""Corrected p-value that a line has to fall below: one log in a thousand shows one by chance."""
MIN_CYCLES = 5
"""Slower ones cannot be told from drift."""
_APART = 64
"""Bins between sinusoids that are taken at once: out there, sidelobes are below what a line needs."""
_ROUNDS, _ROUNDS_OVER_GAPS = 8, 16
_MOST_PER_LINE = 4
"""Sinusoids that make up one line; a line that needs more of them wanders, and the rest is left to others."""
_COMPARED = 24
"""Peaks over gaps of which the highest is measured: off a bin one may stand back behind its own sidelobe."""
_LONGEST_RELAXED = 2**20
ROUNDING = 1e-8
"""Share of the log's largest value below which a sinusoid may be the arithmetic's."""


Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Sinusoid:
    """Re(c·e^(iωt)).

    Attributes:
        bin_: its frequency in bins of the grid's transform.
        c: amplitude and phase.
        p_value: that noise alone shows such a peak anywhere in the log.
    """

    bin_: float
    c: complex
    p_value: float


def take_out_steady(grid: Gridded, band: float) -> tuple[list[Sinusoid], FloatArray]:
    """Takes significant sinusoids out, strongest first, until there is none.

    Without gaps all that are apart are taken at once. Over gaps a sidelobe of one may be higher than another,
    or two together lead astray: one is taken, then each is put back and looked for anew beside the others
    (Li & Stoica's RELAX, IEEE Trans. SP 44, 1996), where the log is not so long that this takes minutes.

    Args:
        grid: the log; it is changed.
        band: bins within which `_MOST_PER_LINE` sinusoids are enough.

    Returns:
        What was taken out, and the power that is left in each bin.
    """
    found: list[Sinusoid] = []
    whole = len(grid.parts) == 1
    for _ in range(_ROUNDS if whole else _ROUNDS_OVER_GAPS):
        windowed, power = grid.transformed()
        peaks = _peaks(grid, windowed, power, _crowded(found, band))
        if not peaks:
            return found, power
        found += _taken_out(grid, peaks)
        if not whole and grid.fast <= _LONGEST_RELAXED:
            found = _relaxed(grid, found)
    return found, grid.transformed()[1]


def _taken_out(grid: Gridded, peaks: list[tuple[float, float]]) -> list[Sinusoid]:
    return [Sinusoid(bin_, grid.take_out(bin_), p_value) for bin_, p_value in peaks]


def _relaxed(grid: Gridded, found: list[Sinusoid]) -> list[Sinusoid]:
    """Each sinusoid put back and taken out anew; one that does not stand out any more stays in."""
    for one in list(found):
        grid.put_in(one.bin_, one.c)
        windowed, power = grid.transformed()
        again = _taken_out(grid, _peaks(grid, windowed, power, []))
        found = [other for other in found if other is not one] + again
    return found


def _crowded(found: list[Sinusoid], band: float) -> list[Range]:
    """Ranges of bins that have given as many sinusoids as one line is allowed."""
    bins = np.array([one.bin_ for one in found])
    return [(b - band, b + band) for b in bins if np.count_nonzero(np.abs(bins - b) < band) >= _MOST_PER_LINE]


def _peaks(
    grid: Gridded, windowed: FloatArray, power: FloatArray, crowded: list[Range]
) -> list[tuple[float, float]]:
    """Significant peaks, in bins with their p-values; over gaps, with their many sidelobes, the highest."""
    least = (ROUNDING * grid.scale * float(grid.weight.sum())) ** 2
    whole = len(grid.parts) == 1
    found: list[tuple[float, float, float]] = []
    for k in candidates(power, SIGNIFICANCE):
        taken = any(abs(k - bin_) < _APART for bin_, _, _ in found) if whole else len(found) == _COMPARED
        if taken or any(low < k < high for low, high in crowded):
            continue
        bound = 1.3 * float(power[k] + power[[k - 1, min(k + 1, len(power) - 1)]].max())
        if _p_value(power, int(k), bound) > SIGNIFICANCE:
            continue
        bin_, height = grid.sharpen(windowed, float(k))
        if not MIN_CYCLES <= bin_ <= len(power) - 1 - LOWEST or height < least:
            continue
        p_value = _p_value(power, round(bin_), height)
        if p_value <= SIGNIFICANCE:
            found.append((bin_, p_value, height))
    if not whole:
        found = sorted(found, key=lambda one: -one[2])[:1]
    return [(bin_, p_value) for bin_, p_value, _ in found]


def _p_value(power: FloatArray, k: int, height: float) -> float:
    """That noise shows such a peak at any frequency (Baluev 2008, equation 5, for a window of T²/12)."""
    ratio, p_value = excess(power, k, height, averaged=1)
    return min(p_value * len(power) * math.sqrt(math.pi * max(ratio, 1.0) / 3.0), 1.0)
