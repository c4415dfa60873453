"""A log as it came → uniformly spaced samples, in segments without a gap, and what was done to get there.

No sample is interpolated, since that colours the noise. Only where a few are missing here and there is a
straight line drawn over them, so that the log stays in one piece.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.noise.timestamps import Grid, grid_of

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MOST_BRIDGED = 10
"""Missing samples in a row that a straight line may stand for; a longer gap parts the log."""
MOST_BRIDGED_SHARE = 0.05
"""Share of the log that may be such lines; they take half of it off the variance of white noise."""
RATE_TOLERANCE = 0.01
SHREDS = 16
"""Samples between gaps: with fewer, on the mean, the pieces say nothing."""
SLOW = "temperature_c"
"""Measured seldom on some boards; between two values it is taken as on the line between them."""


@dataclass(frozen=True, slots=True, eq=False)
class UniformLog:
    """Uniformly spaced samples.

    Attributes:
        rate_hz: samples per second within a segment.
        duration_s: from the first sample to one period after the last, gaps included.
        channels: (N,) each, by name, finite.
        segments: runs of samples without a gap, in order; together all of them.
        start_s: when each segment starts, from the first sample on.
        gaps: how many times samples are missing by `time_s`.
        not_finite: how many samples had a value that is no number.
        notes: what was dropped, bridged, unwrapped or doubted, one sentence each.
    """

    rate_hz: float
    duration_s: float
    channels: dict[str, FloatArray]
    segments: tuple[slice, ...]
    start_s: tuple[float, ...]
    gaps: int
    not_finite: int
    notes: tuple[str, ...]


def uniform_log(
    channels: dict[str, FloatArray], time_s: FloatArray | None, rate_hz: float | None
) -> UniformLog:
    """Puts a log's samples on a uniform grid.

    A clean log comes back as it is, without a copy.

    Args:
        channels: (N,) each, by name; NaN where not known.
        time_s: (N,) stamps in s; may jitter, clump, wrap or go backwards. None without any.
        rate_hz: what the user says; wins over what `time_s` tells.

    Raises:
        ValueError: there is no rate, or nothing is left.
    """
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise ValueError(f"the rate is {rate_hz} Hz; it must be above 0")
    notes: list[str] = []
    channels = _with_values(channels, notes)
    count = len(next(iter(channels.values())))
    grid = _grid(time_s, rate_hz, count)
    notes += grid.notes
    finite = np.logical_and.reduce([np.isfinite(values) for values in channels.values()])
    not_finite = count - int(np.count_nonzero(finite))
    if not_finite:
        notes.append(f"{not_finite} of {count} samples have a value that is no number; left out.")
    if count == not_finite:
        raise ValueError("no sample of the log has a number in every channel")
    if grid.place is None and not not_finite:
        duration_s = count / grid.rate_hz
        return UniformLog(
            grid.rate_hz, duration_s, channels, (slice(0, count),), (0.0,), grid.gaps, 0, tuple(notes)
        )
    place = np.arange(count) if grid.place is None else grid.place
    log = _in_segments(channels, finite, place, grid, not_finite)
    return replace(log, notes=(*notes, *log.notes))


def _with_values(channels: dict[str, FloatArray], notes: list[str]) -> dict[str, FloatArray]:
    """The channels that have values; a slow one gets its values between those measured."""
    if len({len(values) for values in channels.values()}) != 1:
        raise ValueError("a log needs channels, all of one length")
    kept: dict[str, FloatArray] = {}
    for name, values in channels.items():
        known = np.isfinite(values)
        share = np.count_nonzero(known) / max(len(values), 1)
        if share == 0.0:
            notes.append(f"{name} has no number; left out.")
        elif name == SLOW and share < 1.0:
            rows = np.flatnonzero(known)
            kept[name] = np.interp(np.arange(len(values)), rows, values[rows])
            notes.append(
                f"{name} is known in {len(rows)} of {len(values)} samples; on straight lines in between."
            )
        elif share < 0.5:
            notes.append(f"{name} has a number in {share:.1%} of the samples only; left out.")
        else:
            kept[name] = values
    if not kept:
        raise ValueError("no channel of the log has enough numbers")
    return kept


def _grid(time_s: FloatArray | None, rate_hz: float | None, count: int) -> Grid:
    """The grid of the samples; what `rate_hz` says goes before what the stamps do."""
    if time_s is not None and len(time_s) != count:
        raise ValueError(f"time_s has {len(time_s)} values and the channels {count}")
    told, why = None, "the log has no time_s"
    if time_s is not None and count >= 2:
        try:
            told = _not_in_shreds(grid_of(time_s))
        except ValueError as error:
            why = str(error)
    if told is None:
        if rate_hz is None:
            raise ValueError(f"the rate is not known, since {why}; give it with --rate")
        return Grid(
            rate_hz, None, 0, () if time_s is None else (f"The rate given stands alone, since {why}.",)
        )
    if rate_hz is None:
        return told
    notes = told.notes
    if abs(told.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
        notes += (
            f"The rate given, {rate_hz:.6g} Hz, is not the {told.rate_hz:.6g} Hz that time_s tells; "
            "the one given is used.",
        )
    return replace(told, rate_hz=rate_hz, notes=notes)


def _not_in_shreds(grid: Grid) -> Grid:
    """The grid, or its samples side by side where its pieces would be too short to say anything."""
    if grid.place is None or _bridged(np.diff(grid.place) - 1).any():
        return grid
    count = len(grid.place)
    if count >= SHREDS * (grid.gaps + 1):
        return grid
    rate_hz = grid.rate_hz * (count - 1) / float(grid.place[-1] - grid.place[0])
    note = (
        f"time_s is too uneven to tell a gap from jitter ({grid.gaps} of them in {count} samples); "
        f"the samples are taken as evenly spaced at their mean rate of {rate_hz:.6g} Hz."
    )
    return Grid(rate_hz, None, grid.gaps, (*grid.notes, note))


def _bridged(missing: IntArray) -> BoolArray:
    """Which gaps a straight line stands for: short ones, as long as they are few."""
    short: BoolArray = (missing > 0) & (missing <= MOST_BRIDGED)
    few = missing[short].sum() <= MOST_BRIDGED_SHARE * len(missing)
    return short if few else np.zeros_like(short)


def _in_segments(
    channels: dict[str, FloatArray], finite: BoolArray, place: IntArray, grid: Grid, not_finite: int
) -> UniformLog:
    place = place[finite]
    missing = np.diff(place) - 1
    bridged = _bridged(missing)
    notes = []
    if bridged.any():
        notes.append(
            f"{int(missing[bridged].sum())} missing samples, in {int(bridged.sum())} short gaps, "
            "are taken as on straight lines."
        )
    row = np.concatenate(([0], np.cumsum(np.where(bridged, missing, 0) + 1)))
    count = int(row[-1]) + 1
    if count > len(row):
        channels = {
            name: np.interp(np.arange(count), row, values[finite]) for name, values in channels.items()
        }
    elif not finite.all():
        channels = {name: values[finite] for name, values in channels.items()}
    parted = np.flatnonzero((missing > 0) & ~bridged)
    first, last = np.concatenate(([0], parted + 1)), np.concatenate((parted, [len(row) - 1]))
    segments = tuple(slice(int(row[a]), int(row[b]) + 1) for a, b in zip(first, last, strict=True))
    if len(segments) > 1:
        longest = max(part.stop - part.start for part in segments) / grid.rate_hz
        notes.append(
            f"The log is in {len(segments)} pieces, the longest of {longest:.3g} s; nothing joins them."
        )
    return UniformLog(
        rate_hz=grid.rate_hz,
        duration_s=float(place[-1] - place[0] + 1) / grid.rate_hz,
        channels=channels,
        segments=segments,
        start_s=tuple(float(place[a] - place[0]) / grid.rate_hz for a in first),
        gaps=grid.gaps,
        not_finite=not_finite,
        notes=tuple(notes),
    )
