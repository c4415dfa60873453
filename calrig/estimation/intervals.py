"""Segments of a log without a gap, and the static and dynamic intervals in them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import MAD_TO_STD, FloatArray
from calrig.estimation.gyro import MIN_TURN_DEG

GAP_INTERVALS = 2.5
"""A gap is where more than this many ordinary intervals pass without a sample."""
SETTLE_S = 1.0
"""A filter is judged as standing only this long after its start or a move: a plan's own `settle_s`."""

_MIN_RATE_DPS = 0.5
_SIGMAS = 6.0
_SMOOTHING_S = 0.05
_JOIN_S = 0.2
_MARGIN_S = 0.05
_MARGIN_WITHOUT_GYRO_S = 0.15
"""The slope of a noisy elevation sees a move only once it is well under way."""


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of one segment without a gap; slices of indices into the log.

    Attributes:
        dynamic: wherever it turns or is knocked, in order, with a margin on either side.
        moves: those of `dynamic` after which it stands elsewhere, by `MIN_TURN_DEG` or more.
        static: what lies between, each from `SETTLE_S` after the disturbance or the start on.
    """

    dynamic: tuple[slice, ...]
    moves: tuple[slice, ...]
    static: tuple[slice, ...]


def segments_of(time_s: FloatArray) -> list[slice]:
    """Return the longest runs of samples without a gap, in order.

    `time_s` (n,) strictly increases.
    """
    if len(time_s) == 0:
        return []
    steps = np.diff(time_s)
    breaks = np.flatnonzero(steps > GAP_INTERVALS * np.median(steps)) + 1 if len(steps) else np.empty(0, int)
    ends = [0, *breaks.tolist(), len(time_s)]
    return [slice(a, b) for a, b in pairwise(ends)]


def find_intervals(
    time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray | None, within: slice
) -> Intervals:
    """Find the moves in a segment without a gap of a log that stands for most of it.

    It turns where the rate, smoothed over 50 ms, departs from its median by `_MIN_RATE_DPS` and by six times
    its robust spread; without a gyro, the slope of the elevation over 0.1 s is the rate, and slow moves drown
    in its noise.

    Args:
        time_s: (n,) strictly increasing.
        elevation_deg: (n,) continuous elevation of the accelerometer, finite.
        rate_dps: (n,) rate about the axis of elevation, finite; None where there is no gyro.
        within: the segment.
    """
    time, elevation = time_s[within], elevation_deg[within]
    if len(time) < 2:
        return Intervals((), (), ())
    interval_s = float(np.median(np.diff(time)))
    rate = _slope(elevation, interval_s) if rate_dps is None else _smooth(rate_dps[within], interval_s)
    speed = np.abs(rate - np.median(rate))
    threshold = max(_MIN_RATE_DPS, _SIGMAS * MAD_TO_STD * float(np.median(speed)))
    margin_s = _MARGIN_S if rate_dps is not None else _MARGIN_WITHOUT_GYRO_S
    runs = _runs(speed > threshold, round(_JOIN_S / interval_s), round(margin_s / interval_s))
    first = within.start
    dynamic = tuple(slice(first + a, first + b) for a, b in runs)
    moves = tuple(slice(first + a, first + b) for a, b in runs if _turned(elevation, a, b, interval_s))
    return Intervals(dynamic, moves, _static(dynamic, within, round(SETTLE_S / interval_s)))


def _smooth(x: FloatArray, interval_s: float) -> FloatArray:
    from scipy.ndimage import uniform_filter1d

    smoothed = uniform_filter1d(x, max(1, round(_SMOOTHING_S / interval_s)), mode="nearest")
    return np.asarray(smoothed, dtype=np.float64)


def _slope(x: FloatArray, interval_s: float) -> FloatArray:
    half = max(1, round(_SMOOTHING_S / interval_s))
    smoothed = np.pad(_smooth(x, interval_s), half, mode="edge")
    return np.asarray((smoothed[2 * half :] - smoothed[: -2 * half]) / (2 * half * interval_s))


def _runs(active: npt.NDArray[np.bool_], join: int, margin: int) -> list[tuple[int, int]]:
    """Return runs of True with a margin on either side, those nearer than `join` taken together."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for a, b in edges.reshape(-1, 2).tolist():
        begin, end = max(a - margin, 0), min(b + margin, len(active))
        if runs and begin - runs[-1][1] < join:
            begin = runs.pop()[0]
        runs.append((begin, end))
    return runs


def _turned(elevation: FloatArray, begin: int, end: int, interval_s: float) -> bool:
    samples = max(1, round(0.1 / interval_s))
    before, after = elevation[max(begin - samples, 0) : begin], elevation[end : end + samples]
    if not len(before) or not len(after):
        return False  # under way where the segment begins or ends
    return bool(abs(after.mean() - before.mean()) >= MIN_TURN_DEG)


def _static(dynamic: tuple[slice, ...], within: slice, settle: int) -> tuple[slice, ...]:
    begins = [within.start, *(one.stop for one in dynamic)]
    ends = [*(one.start for one in dynamic), within.stop]
    return tuple(slice(a + settle, b) for a, b in zip(begins, ends, strict=True) if a + settle < b)
