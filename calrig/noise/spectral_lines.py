"""Spectral lines of a log: tones that exceed the noise around them, whatever its colour.

The periodogram of the whole log is compared, bin by bin, with a smooth local background that is fitted on a
double logarithmic scale to the bins around (Whittle's likelihood, a gamma regression). Noise is exponential
about that background, so a peak's p-value is the upper tail of F with the freedom of bin and background,
corrected for the number of bins and for a maximum over all frequencies, W·√z·e^(−z) (Baluev, MNRAS 385,
2008). The strongest sinusoids are measured and subtracted from the samples, and the search is repeated, so
that sidelobes of the ends or of gaps are not taken for lines. A tone that wanders fills several bins: it is
searched for in the remainder, in means over 8, 64, … bins. A peak over ten bins or more is a resonance.

The log lies on one uniform grid, gaps included. Gaps are filled with the slow course of the log, so that a
drift makes no comb of them. The ends are tapered (Tukey's window; Harris, Proc. IEEE 66, 1978), which costs
4 % of a sinusoid's power against the noise; Hann's window costs 33 %.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft
from scipy.interpolate import PchipInterpolator
from scipy.special import digamma, fdtrc, gammainccinv, gammaincinv

from calrig.estimation.angles import FloatArray, IntArray
from calrig.model.noise import SpectralLine as Line

LOWEST = 2
"""Bins that the taken straight line and the ends' taper spoil."""
GUARD = 2
"""Bins on either side of a peak that belong to it."""
_NEAR, _REACH = 12, 96
_NARROW_P, _NARROW_SHARE = 1e-4, 0.1
_LEAST_BINS = 6
MOST_CANDIDATES = 512
_CLIP = 5.0
_MEDIAN_EFFICIENCY = math.log(2.0) ** 2
_STEEP, _BLOCK = 768, 256


def candidates(power: FloatArray, significance: float) -> IntArray:
    """Return bins beside which a significant peak may lie, highest over a rough background first.

    Two neighbouring bins hold at least 0.81 of a sinusoid's power. Where the background is known roughly
    only, at the lowest bins, they need less to be looked at.

    `power` (M,) is of each bin; `significance` is the family-wise p-value, over all bins.
    """
    pair = power[:-1] + power[1:]
    pair /= rough_background(power)[:-1]
    pair[: LOWEST + 1] = 0.0
    needed = math.log(len(power) / significance)
    chosen = np.flatnonzero(pair > 0.5 * needed)
    low = np.flatnonzero(pair[:_STEEP] > 0.35 * needed)
    chosen = np.union1d(low, chosen)
    chosen = chosen[np.argsort(pair[chosen])[::-1]][:MOST_CANDIDATES]
    return np.asarray(np.where(power[chosen + 1] > power[chosen], chosen + 1, chosen), dtype=np.int64)


def rough_background(power: FloatArray, averaged: int = 1) -> FloatArray:
    """(M,) mean of the noise in each bin, by the medians of blocks of bins, wider at higher frequency."""
    edges = [0, LOWEST]
    while edges[-1] < min(_STEEP, len(power)):
        edges.append(edges[-1] + max(4, edges[-1] // 2))
    edges = [*edges[:-1], min(edges[-1], len(power))]
    level = np.empty_like(power)
    for a, b in pairwise(edges):
        level[a:b] = np.median(power[a:b])
    first = edges[-1]
    last = first + (len(power) - first) // _BLOCK * _BLOCK
    level[first:last] = np.repeat(np.median(power[first:last].reshape(-1, _BLOCK), axis=1), _BLOCK)
    if last < len(power):
        level[last:] = np.median(power[max(len(power) - _BLOCK, LOWEST) :])
    return np.asarray(np.maximum(level, np.finfo(np.float64).tiny) / _median(averaged), dtype=np.float64)


def _median(averaged: int) -> float:
    """Return median of a mean of exponentials of mean 1."""
    return float(gammaincinv(averaged, 0.5)) / averaged


def excess(power: FloatArray, k: int, height: float, averaged: int) -> tuple[float, float]:
    """Return how a peak compares with its surroundings.

    The background is the power law, or from 48 bins on its parabola on a double logarithmic scale, that fits
    the bins around best.

    `power` (M,) is exponential about the background, or means over `averaged` such; `height` is `power[k]` or
    a maximum beside it.

    Returns:
        The ratio of the peak to the background, and the p-value of such a ratio at this one bin; 1 where the
        peak is not narrow.
    """
    j = np.arange(max(LOWEST, k - _REACH, k // 3), min(len(power) - 1, k + _REACH + 1, 3 * k + 1))
    j = j[np.abs(j - k) > GUARD]
    if len(j) < _LEAST_BINS:
        return 1.0, 1.0
    u = np.log(j / k)
    columns = np.stack([np.ones_like(u), u, u * u][: 3 if len(j) >= 48 else 2], axis=1)
    values = np.maximum(power[j], np.finfo(np.float64).tiny)
    inverse = np.linalg.pinv(columns)
    fitted = inverse @ (np.log(values) + math.log(averaged) - digamma(averaged))
    for _ in range(5):
        shares = np.minimum(values * np.exp(-columns @ fitted), _CLIP)
        fitted = fitted + inverse @ (shares - 1.0)
    background = math.exp(fitted[0])
    spread = float(np.sum((shares - 1.0) ** 2)) * averaged / (len(j) - columns.shape[1])
    inflation = max(spread, 1.0) if averaged > 1 else 1.0
    freedom = averaged / inflation
    around = freedom / float(inverse[0] @ inverse[0])
    ratio = height / background
    near = np.abs(j - k) <= _NEAR
    beside = float(np.median(values[near] * np.exp(-columns[near] @ fitted)))
    beside /= _median(averaged)
    few = freedom * _MEDIAN_EFFICIENCY * float(np.count_nonzero(near))
    narrow = (
        beside - 1.0 <= _NARROW_SHARE * (ratio - 1.0)
        and fdtrc(2.0 * freedom, 2.0 * few, ratio / beside) < _NARROW_P
    )
    return ratio, float(fdtrc(2.0 * freedom, 2.0 * around, ratio)) if narrow else 1.0


ComplexArray = npt.NDArray[np.complex128]

TAPERED = 0.05
"""Share of the log that is tapered at either end."""
SPARSEST, LARGEST_SPARSE = 4, 2**23
"""Grid points for a sample at most, unless the grid is no larger than that anyway."""
_ROWS = 64
_SPANS = 64
"""Parts of the log whose means are its slow course."""
_ZOOM = np.linspace(-1.0, 1.0, 33)
_ZOOMS = 3
"""Each sixteen times as close."""


@dataclass(frozen=True, slots=True, eq=False)
class Gridded:
    """Samples on a uniform grid, in `_ROWS` equal rows of which the last ends in zeros.

    Attributes:
        y: (rows, width) samples about their straight line; straight lines in the gaps.
        taper: (rows, width) the window; 0 behind the end.
        weight: (rows, width) the window where there is a sample, else 0; `taper` itself without gaps.
        parts: where the samples lie on the grid.
        fast: length of the transform.
        scale: largest value of the log as it came.
    """

    y: FloatArray
    taper: FloatArray
    weight: FloatArray
    parts: tuple[slice, ...]
    fast: int
    rate_hz: float
    scale: float

    def transformed(self) -> tuple[FloatArray, FloatArray]:
        """Return what is transformed, and its power.

        Returns:
            (rows, width) tapered samples, and (fast//2 + 1,) |transform|²: a sinusoid of amplitude A on a bin
            gives (A/2·Σ taper)².
        """
        windowed = self.y * self.taper
        transform = rfft(windowed.ravel()[: self.parts[-1].stop], self.fast)
        power = transform.real**2
        power += transform.imag**2
        return windowed, power

    def sharpen(self, windowed: FloatArray, bin_: float) -> tuple[float, float]:
        """Return the highest peak within one bin of `bin_`: where, in bins, and its power."""
        width, step = windowed.shape[1], 2.0 * np.pi / self.fast
        middle = (np.arange(_ROWS) + 0.5) * width * step
        reach = 1.0
        for _ in range(2):  # rows are demodulated again: within a row, the middle stands for all of it
            rows, offset = _demodulated(windowed, bin_ * step), 0.0
            for _ in range(_ZOOMS):
                offsets = offset + reach * _ZOOM
                heights = np.abs(np.exp(-1j * offsets[:, None] * middle) @ rows)
                offset = float(offsets[int(np.argmax(heights))])
                reach /= 16.0
            bin_ += offset
            reach *= 4.0
        return bin_, float(np.abs(_demodulated(windowed, bin_ * step).sum()) ** 2)

    def take_out(self, bin_: float) -> complex:
        """Subtract the sinusoid Re(c·e^(iωt)) of that frequency, by least squares; return c."""
        omega = 2.0 * np.pi * bin_ / self.fast
        total = float(self.weight.sum())
        # the samples are ½(c·e^{iωt} + c̄·e^{−iωt}): near 0 and Nyquist, and over gaps, the second half counts
        at, twice = (
            _demodulated(self.y * self.weight, omega).sum(),
            _demodulated(self.weight, 2 * omega).sum(),
        )
        c = complex(2.0 * (total * at - twice * np.conj(at)) / (total**2 - abs(twice) ** 2))
        self.put_in(bin_, -c)
        if len(self.parts) > 1:
            _fill(self.y.ravel(), self.weight.ravel(), self.parts)
        return c

    def put_in(self, bin_: float, c: complex) -> None:
        """Add the sinusoid Re(c·e^(iωt)) to the samples; what lies in the gaps stays as it is."""
        rows, width = self.y.shape
        omega = 2.0 * np.pi * bin_ / self.fast
        cosine, sine = np.cos(omega * np.arange(width)), np.sin(omega * np.arange(width))
        start = c * np.exp(1j * omega * width * np.arange(rows))
        for row in range(rows):
            wave = start[row].real * cosine - start[row].imag * sine
            self.y[row] += np.where(self.weight[row] > 0.0, wave, 0.0)


def lay_out(x: FloatArray, rate_hz: float, segments: Sequence[slice], start_s: Sequence[float]) -> Gridded:
    """Put a log on its grid.

    Of a log with gaps that would make the grid sparse and large, the segment with most samples is taken.

    `x` (N,) is finite; `segments` are runs of samples without a gap, in order, each beginning at `start_s`.
    """
    lengths = np.array([part.stop - part.start for part in segments], dtype=np.int64)
    starts = np.rint((np.asarray(start_s) - start_s[0]) * rate_hz).astype(np.int64)
    chosen = _dense_segment(starts, lengths)
    starts = starts[chosen] - starts[chosen][0]
    parts = tuple(slice(int(a), int(a + n)) for a, n in zip(starts, lengths[chosen], strict=True))
    count = parts[-1].stop
    y = np.zeros((_ROWS, -(-count // _ROWS)))
    taper = np.zeros_like(y)
    _tukey(taper.ravel()[:count])
    flat, weight = y.ravel(), taper
    if len(parts) == 1:
        flat[:count] = x[segments[chosen.start]]
    else:
        weight = np.zeros_like(y)
        for part, segment in zip(parts, segments[chosen], strict=True):
            flat[part] = x[segment]
            weight.ravel()[part] = 1.0
        _fill(flat, weight.ravel(), parts)
    scale = max(float(y.max()), -float(y.min()))
    _straighten(flat[:count])
    if len(parts) > 1:
        weight *= taper
    return Gridded(y, taper, weight, parts, next_fast_len(count, real=True), rate_hz, scale)


def _dense_segment(starts: IntArray, lengths: IntArray) -> slice:
    """The segments that hold most samples within a grid of bearable size; all of them, where they fit."""
    most = max(LARGEST_SPARSE, SPARSEST * int(lengths.sum()))
    ends = starts + lengths
    last = np.searchsorted(ends, starts + most, side="right")
    total = np.concatenate(([0], np.cumsum(lengths)))
    first = int(np.argmax(total[last] - total[:-1]))
    return slice(first, int(last[first]))


def _straighten(flat: FloatArray) -> None:
    """Subtract the least-squares line, in place."""
    t = np.linspace(-1.0, 1.0, len(flat))
    flat -= flat.mean()
    flat -= t * (float(t @ flat) / float(t @ t))


def _fill(y: FloatArray, weight: FloatArray, parts: Sequence[slice]) -> None:
    """Draw the slow course of the log through its gaps, in place: smoothly through its spans' means."""
    count = parts[-1].stop
    edges = np.linspace(0, count, _SPANS + 1).astype(np.int64)[:-1]
    mass = np.add.reduceat(weight[:count], edges)
    known = mass > 0.0
    t = np.arange(count, dtype=np.float64)
    place = np.add.reduceat(weight[:count] * t, edges)[known] / mass[known]
    course = np.zeros(count)
    for _ in range(2):  # the first course bends less than the means that it goes through
        level = np.add.reduceat(weight[:count] * (y[:count] - course), edges)[known] / mass[known]
        course += PchipInterpolator(place, level)(t)
    for before, after in pairwise(parts):
        gap = slice(before.stop, after.start)
        y[gap] = course[gap]


def _tukey(taper: FloatArray) -> None:
    taper[:] = 1.0
    count = max(int(TAPERED * len(taper)), 1)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    taper[:count], taper[-count:] = rise, rise[::-1]


def _demodulated(x: FloatArray, omega: float) -> ComplexArray:
    """Return (rows,) Σ x·e^{−iωt} over each row."""
    rows, width = x.shape
    angle = omega * np.arange(width)
    sums = x @ np.cos(angle) - 1j * (x @ np.sin(angle))
    return np.asarray(sums * np.exp(-1j * omega * width * np.arange(rows)))


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
    """Subtract significant sinusoids, strongest first, until none is left.

    Without gaps all that are apart are taken at once. Over gaps a sidelobe of one may be higher than another,
    or two together lead astray: one is taken, then each is put back and searched for again with the others
    (Li & Stoica's RELAX, IEEE Trans. SP 44, 1996), where the log is not so long that this takes minutes.

    `grid`, the log, is changed; `band` are bins within which `_MOST_PER_LINE` sinusoids are enough.

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
    """Return each sinusoid put back and taken out again; one that does not stand out any more stays in."""
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


MIN_SAMPLES = 256
FINEST_BANDS = 16384
"""A tone may wander over rate/16384 and is still one line; lines nearer to each other are one, too."""
_WIDER = 8
_LEAST_RATIO = 2.0
"""What a wandering tone has to make of the noise around it; less may be a bend of the noise itself."""


def find_lines(
    x: FloatArray, rate_hz: float, segments: Sequence[slice], start_s: Sequence[float]
) -> tuple[Line, ...]:
    """Spectral lines of a log, strongest first.

    Harmonics are lines of their own. None has fewer than `sinusoids.MIN_CYCLES` periods in the log. An
    amplitude is half of peak to peak; a p-value is that noise alone shows such a line anywhere in the log.

    `x` (N,) are finite samples; `segments` are runs of them without a gap, in order, `start_s` is when each
    begins, in s.
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
    """Return the tone whose power fills the band `k` and its neighbours (Parseval's relation)."""
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
        p_value = min(tone.p_value for tone in group)
        lines.append(Line(frequency_hz=frequency_hz, amplitude=math.sqrt(power), p_value=p_value))
    return tuple(sorted(lines, key=lambda line: -line.amplitude))
