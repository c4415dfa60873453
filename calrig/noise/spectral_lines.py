"""Spectral lines: tones that stand out of the noise around them, whatever its colour.

The periodogram of the whole log is compared, bin by bin, with a smooth local background that is fitted on a
double logarithmic scale to the bins around (Whittle's likelihood, a gamma regression). Noise is exponential
about that background, so a peak's p-value is the upper tail of F with the freedom of bin and background. It
is corrected for the number of bins, and for a maximum over all frequencies instead of bins, W·√z·e^(−z)
(Baluev, MNRAS 385, 2008). The strongest are measured, taken out of the samples, and the search begins anew:
so sidelobes, be they of the ends or of gaps, are not taken for lines. A tone that wanders fills several bins
and is looked for in what is left, in means over 8, 64, … bins.

A peak is a line only if it is narrow: noise that peaks over ten bins or more is a resonance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from calrig.estimation.angles import FloatArray
from calrig.noise.peaks import LOWEST, excess, rough_background
from calrig.noise.periodogram import Gridded, lay_out
from calrig.noise.sinusoids import ROUNDING, SIGNIFICANCE, take_out_steady

MIN_SAMPLES = 256
FINEST_BANDS = 16384
"""A tone may wander over rate/16384 and is still one line; lines nearer to each other are one, too."""
_WIDER = 8
_LEAST_RATIO = 2.0
"""What a wandering tone has to make of the noise around it; less may be a bend of the noise itself."""


@dataclass(frozen=True, slots=True)
class Line:
    """A tone.

    Attributes:
        frequency_hz: where.
        amplitude: of the sinusoid, in the channel's unit (half of peak to peak).
        p_value: that noise alone shows such a line anywhere in the log.
    """

    frequency_hz: float
    amplitude: float
    p_value: float


def find_lines(
    x: FloatArray, rate_hz: float, segments: Sequence[slice], start_s: Sequence[float]
) -> tuple[Line, ...]:
    """Spectral lines of a log, strongest first.

    Harmonics are lines of their own. None has fewer than `sinusoids.MIN_CYCLES` periods in the log.

    Args:
        x: (N,) finite samples.
        rate_hz: samples a second.
        segments: runs of samples without a gap, in order.
        start_s: when each begins, in s.
    """
    if sum(part.stop - part.start for part in segments) < MIN_SAMPLES or np.ptp(x) == 0.0:
        return ()
    grid = lay_out(x, rate_hz, segments, start_s)
    bin_hz = rate_hz / grid.fast
    band_hz = max(rate_hz / FINEST_BANDS, _WIDER * bin_hz)
    steady, power = take_out_steady(grid, band_hz / bin_hz)
    tones = [_Tone(one.bin_ * bin_hz, abs(one.c), one.p_value, band_hz) for one in steady]
    tones += _wide(grid, power, band_hz)
    return _merged([tone for tone in tones if tone.amplitude > ROUNDING * grid.scale])


@dataclass(frozen=True, slots=True)
class _Tone:
    """A sinusoid, or a band that a tone fills; others within its reach are the same line."""

    frequency_hz: float
    amplitude: float
    p_value: float
    reach_hz: float


def _wide(grid: Gridded, power: FloatArray, band_hz: float) -> list[_Tone]:
    """Tones that wander over several bins, in what is left of the power when the steady ones are out."""
    found: list[_Tone] = []
    bins, bin_hz = _WIDER, grid.rate_hz / grid.fast
    while bins * bin_hz <= band_hz:
        means = power[: len(power) // bins * bins].reshape(-1, bins).mean(axis=1)
        needed = float(gammainccinv(bins, SIGNIFICANCE / len(means))) / bins
        high = means > max(0.7 * needed, _LEAST_RATIO) * rough_background(means, bins)
        high[1:] &= means[1:] > means[:-1]
        high[:-1] &= means[:-1] >= means[1:]
        for k in np.flatnonzero(high[_WIDER:-LOWEST]) + _WIDER:
            ratio, p_value = excess(means, int(k), float(means[k]), averaged=bins)
            p_value = min(p_value * len(means), 1.0)
            if p_value <= SIGNIFICANCE and ratio >= _LEAST_RATIO:
                found.append(_from_band(grid, power, int(k), bins, float(means[k]) / ratio, p_value))
        bins *= _WIDER
    return found


def _from_band(
    grid: Gridded, power: FloatArray, k: int, bins: int, background: float, p_value: float
) -> _Tone:
    """The tone whose power fills the band `k` and its neighbours (Parseval's relation)."""
    first, bin_hz = (k - 1) * bins, grid.rate_hz / grid.fast
    surplus = power[first : first + 3 * bins] - background
    middle = float(surplus @ np.arange(3 * bins) / surplus.sum())
    amplitude = math.sqrt(4.0 * float(surplus.sum()) / (grid.fast * float(np.sum(grid.weight**2))))
    return _Tone((first + middle) * bin_hz, amplitude, p_value, 3 * bins * bin_hz)


def _merged(tones: list[_Tone]) -> tuple[Line, ...]:
    """Lines, strongest first; tones within each other's reach become one of their common power."""
    groups: list[list[_Tone]] = []
    for tone in sorted(tones, key=lambda tone: tone.frequency_hz):
        last = groups[-1][-1] if groups else None
        if last and tone.frequency_hz - last.frequency_hz < max(tone.reach_hz, last.reach_hz):
            groups[-1].append(tone)
        else:
            groups.append([tone])
    lines = []
    for group in groups:
        power = sum(tone.amplitude**2 for tone in group)
        frequency_hz = sum(tone.frequency_hz * tone.amplitude**2 for tone in group) / power
        lines.append(Line(frequency_hz, math.sqrt(power), min(tone.p_value for tone in group)))
    return tuple(sorted(lines, key=lambda line: -line.amplitude))
