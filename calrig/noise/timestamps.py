"""Time stamps as a log has them → which place on a uniform grid each sample has.

A sensor takes its samples evenly; what stamps them afterwards does not. Where the time that passed agrees
with the number of samples, jitter and clumps are the stamps' and not the samples'. Where stamps step ahead
and stay ahead, samples are missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import minimum_filter1d

from calrig.estimation.angles import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

CLOCKS = {2.0**32 * 1e-6: "microseconds", 2.0**32 * 1e-3: "milliseconds"}
"""Counters of 32 bits, by when they wrap, in s: 71.6 minutes and 49.7 days."""
WRAP_SLACK = 0.02
"""Share of the counter's range within which a step back is its wrap, not a restart."""
RESTART_S = 0.5
"""Stamps that jitter step back by less."""
RESTART_GAP = 1000
"""Samples taken for missing where the clock began anew: more than any that are bridged."""
REGULAR_SHARE = 0.7
"""Share of the steps within half of the median one; with less the samples arrive in clumps."""
FILLED_SHARE, CLUMP = 0.2, 32
"""They do too where such steps make up less than this share of the time in runs shorter than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Where samples stand.

    Attributes:
        rate_hz: of the grid.
        place: (N,) place of each sample on it, increasing; None for 0, 1, 2, …
        gaps: how many times samples are missing.
        notes: what a person should know, one sentence each.
    """

    rate_hz: float
    place: IntArray | None
    gaps: int
    notes: tuple[str, ...]


def grid_of(time_s: FloatArray) -> Grid:
    """Finds the uniform grid on which samples were taken.

    Args:
        time_s: (N,) stamps in s as logged, N ≥ 2; they may jitter, clump, wrap, start anew and be NaN.

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
    """Stamps without wraps and restarts; (N − 1,) where the clock began anew."""
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
    """(N − 1,) how many samples are missing between each two.

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
