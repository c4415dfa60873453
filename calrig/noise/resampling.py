"""Place the samples of a log on a uniform grid, in segments without a gap.

A sensor samples evenly; the time stamps are not even. Where the elapsed time agrees with the number of
samples, jitter and clumps are those of the stamps. Where stamps step ahead and stay ahead, samples are
missing. No sample is interpolated, since that colours the noise; only a few isolated missing ones are bridged
by a straight line, so that the log stays in one piece.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter1d

from calrig.estimation.angles import BoolArray, FloatArray, IntArray

CLOCKS = {2.0**32 * 1e-6: "microseconds", 2.0**32 * 1e-3: "milliseconds"}
"""Counters of 32 bits, by when they wrap, in s: 71.6 minutes and 49.7 days."""
WRAP_SLACK = 0.02
"""Share of the counter's range within which a step back is its wrap, not a restart."""
RESTART_S = 0.5
"""Stamps that jitter step back by less."""
RESTART_GAP = 1000
"""Samples counted as missing where the clock restarted: more than any that are bridged."""
REGULAR_SHARE = 0.7
"""Share of the steps within half of the median one; with less the samples arrive in clumps."""
FILLED_SHARE, CLUMP = 0.2, 32
"""They do too where such steps make up less than this share of the time in runs shorter than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Where samples stand.

    Attributes:
        place: (N,) place of each sample on it, increasing; None for 0, 1, 2, …
        gaps: how many times samples are missing.
        notes: what a person should know, one sentence each.
    """

    rate_hz: float
    place: IntArray | None
    gaps: int
    notes: tuple[str, ...]


def grid_of(time_s: FloatArray) -> Grid:
    """Find the uniform grid on which samples were taken.

    `time_s` (N,) are stamps in s as logged, N ≥ 2; they may jitter, clump, wrap, restart and be NaN.

    Raises:
        ValueError: the stamps tell of no rate, since they stand still or are not there.
    """
    time_s, notes = _known(time_s)
    time_s, restarts, more = _forward(time_s)
    notes += more
    steps = np.diff(time_s)
    period_s, clumps = _period(time_s, steps)
    if not period_s > 0.0:
        raise ValueError("time_s does not advance")
    if not clumps and not restarts.any() and steps.min() > 0.5 * period_s and steps.max() < 1.5 * period_s:
        missing = None
        period_s = float(time_s[-1] - time_s[0]) / len(steps)
    else:
        missing = _missing(time_s, steps, period_s, clumps)
        missing[restarts] = RESTART_GAP
        together = ~restarts if clumps else missing == 0
        lost_s = period_s * float(missing[together].sum())
        period_s = (float(steps[together].sum()) - lost_s) / max(int(together.sum()), 1)
    notes += _about_jitter(steps if missing is None else steps[missing == 0], period_s, clumps)
    if missing is None or not missing.any():
        return Grid(1.0 / period_s, None, 0, notes)
    place = np.concatenate(([0], np.cumsum(missing + 1)))
    return Grid(1.0 / period_s, place, int(np.count_nonzero(missing)), notes)


def _known(time_s: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    known = np.isfinite(time_s)
    if known.all():
        return time_s, ()
    if known.sum() < 2:
        raise ValueError("time_s has no values")
    rows = np.arange(len(time_s), dtype=np.float64)
    inner = np.interp(rows, rows[known], time_s[known])
    note = f"{len(time_s) - int(known.sum())} stamps are no numbers; taken as between their neighbours."
    return inner, (note,)


def _forward(time_s: FloatArray) -> tuple[FloatArray, BoolArray, tuple[str, ...]]:
    """Return stamps without wraps and restarts; (N − 1,) where the clock restarted."""
    steps = np.diff(time_s)
    back = np.flatnonzero(steps < -RESTART_S)
    restarts = np.zeros(len(steps), dtype=np.bool_)
    if not len(back):
        return time_s, restarts, ()
    usual = max(float(np.median(steps)), 0.0)
    ahead = np.zeros(len(time_s))
    wraps: list[str] = []
    for at in back:
        clock = next((wrap for wrap in CLOCKS if abs(steps[at] + wrap) < WRAP_SLACK * wrap), None)
        if clock is None:
            restarts[at] = True
        else:
            wraps.append(CLOCKS[clock])
        ahead[at + 1] = usual - steps[at] if clock is None else clock
    notes = [
        f"time_s wraps {wraps.count(unit)} time(s) like a clock of 32 bits in {unit}; unwrapped."
        for unit in sorted(set(wraps))
    ]
    if restarts.any():
        notes.append(
            f"time_s starts anew {int(restarts.sum())} time(s); how long each pause was is not known."
        )
    return time_s + np.cumsum(ahead), restarts, tuple(notes)


def _period(time_s: FloatArray, steps: FloatArray) -> tuple[float, bool]:
    """Sample period in s, and whether samples arrive in clumps."""
    median = float(np.median(steps))
    if median > 0.0:
        near = np.abs(steps - median) <= 0.5 * median
        count = int(np.count_nonzero(near))
        fills = count * median >= FILLED_SHARE * (time_s[-1] - time_s[0])
        if count >= REGULAR_SHARE * len(steps) and (fills or count >= CLUMP * (len(steps) - count)):
            return median, False
    block = min(1024, max(len(steps) // 8, 1))
    lasted = np.sort(time_s[block:] - time_s[:-block])
    return float(lasted[len(lasted) // 4 : len(lasted) - len(lasted) // 4].mean()) / block, True


def _missing(time_s: FloatArray, steps: FloatArray, period_s: float, clumps: bool) -> IntArray:
    """Return (N − 1,) how many samples are missing between each two.

    A stamp may be late but hardly early, so how far time is ahead of the number of samples is the least of
    what a few say. Samples are missing where that steps up.
    """
    missing = np.zeros(len(steps), dtype=np.int64)
    late = time_s - period_s * np.arange(len(time_s))
    width = 2 * _longest_run(steps < 0.25 * period_s) + 4 if clumps else 3
    least = minimum_filter1d(np.pad(late, width, mode="edge"), width, origin=-(width // 2))[
        : len(late) + width
    ]
    before, after = least[1 : len(late)], least[width + 1 :]
    rise = after - before
    candidates = steps > 1.5 * period_s
    threshold = 0.5 * period_s
    if clumps and candidates.any():  # a busy host is late by more than a sample, now and then
        threshold += 5.0 * float(np.median(np.abs(rise[candidates])))
    found = np.flatnonzero(candidates & (rise > threshold))
    if not clumps:
        missing[found] = np.maximum(np.rint(steps[found] / period_s).astype(np.int64) - 1, 1)
        return missing
    for group in np.split(found, np.flatnonzero(np.diff(found) > width) + 1):
        if len(group):
            missing[group[np.argmax(steps[group])]] = max(round(float(rise[group].max()) / period_s), 1)
    return missing


def _longest_run(flags: BoolArray) -> int:
    ends = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((ends[1::2] - ends[::2]).max(initial=0))


def _about_jitter(steps: FloatArray, period_s: float, clumps: bool) -> tuple[str, ...]:
    if not len(steps):
        return ()
    rate = f"{1.0 / period_s:.6g} Hz"
    if clumps:
        return (f"Stamps come in clumps; the samples are taken as evenly spaced at {rate}.",)
    jitter = float(np.std(steps)) / np.sqrt(2.0)
    if jitter < 0.1 * period_s:
        return ()
    return (f"Stamps jitter by {1e3 * jitter:.3g} ms; the samples are taken as evenly spaced at {rate}.",)


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
    channels: dict[str, FloatArray],
    time_s: FloatArray | None,
    rate_hz: float | None,
    left_out: Sequence[slice] = (),
) -> UniformLog:
    """Put a log's samples on a uniform grid.

    A clean log comes back as it is, without a copy.

    Args:
        channels: (N,) each, by name; NaN where not known.
        time_s: (N,) stamps in s; may jitter, clump, wrap or go backwards. None without any.
        rate_hz: what the user says; wins over what `time_s` tells.
        left_out: samples that are as missing.

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
    for stretch in left_out:
        finite[stretch] = False
    if grid.place is None and finite.all():
        duration_s = count / grid.rate_hz
        return UniformLog(
            grid.rate_hz, duration_s, channels, (slice(0, count),), (0.0,), grid.gaps, 0, tuple(notes)
        )
    place = np.arange(count) if grid.place is None else grid.place
    log = _in_segments(channels, finite, place, grid, not_finite)
    return replace(log, notes=(*notes, *log.notes))


def _with_values(channels: dict[str, FloatArray], notes: list[str]) -> dict[str, FloatArray]:
    """Return the channels that have values; a slow one gets its values between those measured."""
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
    """Return the grid of the samples; what `rate_hz` says goes before what the stamps do."""
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
    """Return the grid, or its samples side by side where its pieces would be too short to say anything."""
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
