"""A log on one uniform grid, gaps and all: its periodogram, and sinusoids measured and taken out of it.

In gaps lies the slow course of the log, so that a drift makes no comb of them, and the
ends are tapered (Tukey's window; Harris, Proc. IEEE 66, 1978), so that a drift leaks into few bins. That
costs 4 % of a sinusoid's power against the noise, where Hann's window costs 33 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft
from scipy.interpolate import PchipInterpolator

from calrig.estimation.angles import FloatArray

ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]

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
        rate_hz: of the grid.
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
        """What is transformed, and its power.

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
        """The highest peak within one bin of `bin_`: where, in bins, and its power."""
        width, step = windowed.shape[1], 2.0 * np.pi / self.fast
        middle = (np.arange(_ROWS) + 0.5) * width * step
        reach = 1.0
        for _ in range(2):  # rows are demodulated anew: within a row, the middle stands for all of it
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
        """Takes the sinusoid Re(c·e^(iωt)) of that frequency out, by least squares; returns c."""
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
        """Adds the sinusoid Re(c·e^(iωt)) to the samples; what lies in the gaps stays as it is."""
        rows, width = self.y.shape
        omega = 2.0 * np.pi * bin_ / self.fast
        cosine, sine = np.cos(omega * np.arange(width)), np.sin(omega * np.arange(width))
        start = c * np.exp(1j * omega * width * np.arange(rows))
        for row in range(rows):
            wave = start[row].real * cosine - start[row].imag * sine
            self.y[row] += np.where(self.weight[row] > 0.0, wave, 0.0)


def lay_out(x: FloatArray, rate_hz: float, segments: Sequence[slice], start_s: Sequence[float]) -> Gridded:
    """Puts a log on its grid.

    Of a log with gaps that would make the grid sparse and large, the segment with most samples is taken.

    Args:
        x: (N,) finite.
        rate_hz: of the samples.
        segments: runs of samples without a gap, in order.
        start_s: when each begins.
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
    """Takes the straight line of least squares out, in place."""
    t = np.linspace(-1.0, 1.0, len(flat))
    flat -= flat.mean()
    flat -= t * (float(t @ flat) / float(t @ t))


def _fill(y: FloatArray, weight: FloatArray, parts: Sequence[slice]) -> None:
    """Draws the slow course of the log through its gaps, in place: smoothly through its spans' means."""
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
    """(rows,) Σ x·e^{−iωt} over each row."""
    rows, width = x.shape
    angle = omega * np.arange(width)
    sums = x @ np.cos(angle) - 1j * (x @ np.sin(angle))
    return np.asarray(sums * np.exp(-1j * omega * width * np.arange(rows)))
