"""Segments of a log of samples in which nothing but the sensor's own noise moves."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import BoolArray, FloatArray

Span = tuple[int, int]
"""First sample, and the one after the last."""

QUIET_QUANTILE = 0.1
"""At least this share of a log's windows is taken to be static, and gives the noise."""
ABOVE_NOISE = 2.0
COARSEST_STEP_G = 0.01
"""Two decimals. The spacing of the values of a log without noise is not the sensor's step."""
TURNING_DPS = 1.0
"""So slow and even a rotation shows in the gyro's mean, and hardly in the accelerometer's spread."""
NOISIEST_G = 0.05
"""No sensor at rest is noisier than this; a noisier one moves."""
SAME_POSE_DEG = 2.0
QUARTILE_OF_STEPS = 1.56
"""Lower quartile of the distance of two samples at rest, in standard deviations of an axis (√2·χ₃)."""
JUMP = 8.0
"""A jump between positions, in lower quartiles of the distance: 12 standard deviations of an axis."""
MOST_JUMPS = 20_000
LEVEL_ROWS = 7
"""Rows whose median is the level next to a jump; a glitch of up to three rows does not move it."""
GLITCH_ROWS = 3
STILL_SHARE = 0.9
"""Of the rows, in segments at rest; a log with motion between its poses has less."""
FEW_ROWS = 8
"""Fewer rows in a position than this were written down one by one: none of them is taken for motion."""
SHORT = 0.25
MOSTLY = 0.8


class GravityError(ValueError):
    """The log cannot be calibrated against gravity; the message says what it lacks and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class StaticPoses:
    """n static poses of a log.

    Attributes:
        accel_g: (n, 3) mean measured acceleration.
        temperature_c: (n,) mean; None where the log has none for every pose.
        time_s: (n,) middle of the pose; None without time.
        spans: (n, 2) first sample and the one after the last, in the log.
        noise_g: standard error of the mean of a pose, of one axis, if its samples were independent: root mean
            square over the poses, from the differences of consecutive samples; None for one row a pose.
        finding: how the poses were found, as a sentence; empty where the rate of the samples said it.
    """

    accel_g: FloatArray
    temperature_c: FloatArray | None
    time_s: FloatArray | None
    spans: npt.NDArray[np.intp]
    noise_g: float | None = None
    finding: str = ""

    def __len__(self) -> int:
        return len(self.accel_g)

    def rows(self, chosen: BoolArray) -> Self:
        """Return some of the poses."""
        return replace(
            self,
            accel_g=self.accel_g[chosen],
            temperature_c=None if self.temperature_c is None else self.temperature_c[chosen],
            time_s=None if self.time_s is None else self.time_s[chosen],
            spans=self.spans[chosen],
        )


def poses_of(
    spans: list[Span],
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
    finding: str = "",
) -> StaticPoses:
    """Return the means of the samples in each span; arguments as in `static_poses`."""
    parts = [accel_g[a:b] for a, b in spans]
    pairs = sum(len(part) - 1 for part in parts)
    squares = sum(float((np.diff(part, axis=0) ** 2).sum()) for part in parts)
    share = np.mean([1.0 / len(part) for part in parts]) if parts else 0.0
    return StaticPoses(
        np.array([part.mean(axis=0) for part in parts]).reshape(-1, 3),
        _means(temperature_c, spans),
        _means(time_s, spans),
        np.array(spans, dtype=np.intp).reshape(-1, 2),
        float(np.sqrt(share * squares / (6 * pairs))) if pairs else None,
        finding,
    )


def quiet_spans(
    accel_g: FloatArray, gyro_dps: FloatArray | None, *, width: int, shortest: int, edge: int
) -> list[Span]:
    """Find static segments by the spread within a sliding window, compared with the log's quietest windows.

    The static detector of Tedaldi, Pretto & Menegatti (ICRA 2014, section V), with the noise taken from the
    quietest tenth of the log instead of a static period at its beginning. Neighbouring segments less than 2°
    apart are one pose that was knocked.

    Args:
        accel_g: (N, 3) finite samples.
        gyro_dps: (N, 3), which must not rotate either; None where not known.
        width: samples of the window, at most N.
        shortest: fewest samples of a segment, without its edges.
        edge: samples taken off both ends: a window notices motion only when enough of it has come in.

    Raises:
        GravityError: the log is never static.
    """
    spread = window_spread(accel_g, width)
    noise = float(np.quantile(spread, QUIET_QUANTILE))
    if noise > NOISIEST_G:
        raise GravityError(
            f"the log is never static: over {width} samples the accelerometer changes by "
            f"{noise * 1e3:.0f} mg even at its quietest; lay the sensor down for a few seconds in each pose"
        )
    above = max(ABOVE_NOISE, _scatter_of_spread(width))
    quiet = spread <= above * noise + min(step_of(accel_g), COARSEST_STEP_G)
    if gyro_dps is not None and np.isfinite(gyro_dps).all():
        quiet &= _unturned(gyro_dps, width, quiet)
    return _merged(accel_g, _segments(quiet, width, edge, shortest), nearest=0)


def position_spans(accel_g: FloatArray) -> list[Span]:
    """Find the positions of a table that has some rows of each and no motion between them.

    The rows of a position follow one another with the distance of noise; the next position is a jump away,
    and stays there. A glitch of one or two rows does not.

    Args:
        accel_g: (N, 3) finite samples.

    Returns:
        Spans that cover nearly all rows; none where the table is not of this kind.
    """
    jump = np.linalg.norm(np.diff(accel_g, axis=0), axis=1)
    quartile = float(np.quantile(jump, 0.25)) if len(jump) else 0.0
    if np.sqrt(3.0) * quartile / QUARTILE_OF_STEPS > NOISIEST_G:
        return []
    limit = JUMP * quartile + 2.0 * min(step_of(accel_g), COARSEST_STEP_G)
    edges = np.flatnonzero(jump > limit) + 1
    if len(edges) > MOST_JUMPS:
        return []
    spans = _equal(_joined(accel_g, [0, *map(int, edges), len(accel_g)], limit), len(accel_g))
    length = np.array([b - a for a, b in spans])
    order = np.argsort(length)
    typical = int(length[order][np.searchsorted(np.cumsum(length[order]), len(accel_g) / 2)])
    shortest = 1 if typical < FEW_ROWS else SHORT * typical
    still = [(a, b) for a, b in spans if b - a >= shortest and _rms_about_mean(accel_g[a:b]) <= limit]
    if sum(b - a for a, b in still) < STILL_SHARE * len(accel_g):
        return []
    return _merged(accel_g, still, nearest=1)


def window_spread(values: FloatArray, width: int) -> FloatArray:
    """Return (N − width + 1,) root of the summed variances of the (N, 3) values within each window."""
    centred = values - values.mean(axis=0)  # sums of squares below lose no digits to a common level
    variance = _window_mean(centred**2, width) - _window_mean(centred, width) ** 2
    return np.asarray(np.sqrt(np.maximum(variance.sum(axis=1), 0.0)), dtype=np.float64)


def step_of(accel_g: FloatArray) -> float:
    """Return the sensor's step: a sensor at rest may toggle between two counts, or show no noise at all."""
    steps = [np.diff(np.unique(column)) for column in accel_g.T]
    return min((float(step.min()) for step in steps if len(step)), default=0.0)


def _scatter_of_spread(width: int) -> float:
    """Return how far one window of pure noise in 10⁴ exceeds the quietest tenth (Wilson & Hilferty 1931)."""
    share = 2.0 / (9.0 * 3.0 * (width - 1))
    low, high = (1.0 - share + z * np.sqrt(share) for z in (-1.2816, 3.7190))
    return float((high / low) ** 1.5)


def _window_mean(values: FloatArray, width: int) -> FloatArray:
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return np.asarray((sums[width:] - sums[:-width]) / width, dtype=np.float64)


def _unturned(gyro_dps: FloatArray, width: int, quiet: BoolArray) -> BoolArray:
    """Return the windows in which the gyro, less the median of the quiet ones (its bias), does not rotate."""
    rate = _window_mean(gyro_dps, width)
    if quiet.any():
        rate = rate - np.median(rate[quiet], axis=0)
    return np.asarray(np.linalg.norm(rate, axis=1) <= TURNING_DPS, dtype=np.bool_)


def _segments(quiet: BoolArray, width: int, edge: int, shortest: int) -> list[Span]:
    """Return the samples under quiet windows, less their edges, if long enough.

    Windows that share a sample are of one segment; two poses a jump apart share none.
    """
    change = np.diff(np.concatenate([[0], quiet.astype(np.intp), [0]]))
    whole: list[Span] = []
    for first, last in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1, strict=True):
        begin, end = int(first), int(last) + width
        if whole and begin < whole[-1][1]:
            begin = whole.pop()[0]
        whole.append((begin, end))
    return [(a + edge, b - edge) for a, b in whole if b - a - 2 * edge >= shortest]


def _merged(accel_g: FloatArray, segments: list[Span], *, nearest: int) -> list[Span]:
    """Return the longer of two neighbours that point the same way: a knock makes no second pose.

    Neighbours with fewer samples between them than `nearest` had no knock between them, and stay two.
    """
    kept: list[Span] = []
    for span in segments:
        is_apart = bool(kept) and span[0] - kept[-1][1] >= nearest
        if is_apart and _apart_deg(accel_g, kept[-1], span) < SAME_POSE_DEG:
            kept[-1] = max(kept[-1], span, key=lambda s: s[1] - s[0])
        else:
            kept.append(span)
    return kept


def _apart_deg(accel_g: FloatArray, one: Span, other: Span) -> float:
    a, b = (accel_g[first:last].mean(axis=0) for first, last in (one, other))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _joined(accel_g: FloatArray, edges: list[int], limit: float) -> list[Span]:
    """Return the spans between edges; equal levels are one, and a glitch within a level is part of it."""
    kept: list[Span] = []
    for a, b in pairwise(edges):
        level = np.median(accel_g[a : min(b, a + LEVEL_ROWS)], axis=0)

        def is_level_of(span: Span, level: FloatArray = level) -> bool:
            before = np.median(accel_g[max(span[0], span[1] - LEVEL_ROWS) : span[1]], axis=0)
            return bool(np.linalg.norm(level - before) <= limit)

        if kept and is_level_of(kept[-1]):
            kept[-1] = (kept[-1][0], b)
        elif (
            len(kept) > 1
            and kept[-1][1] - kept[-1][0] < GLITCH_ROWS <= kept[-2][1] - kept[-2][0]
            and is_level_of(kept[-2])
        ):
            kept.pop()
            kept[-1] = (kept[-1][0], b)
        else:
            kept.append((a, b))
    return kept


def _equal(spans: list[Span], rows: int) -> list[Span]:
    """Return spans of equal length if nearly all of them are: a program wrote each position so often."""
    length = int(np.median([b - a for a, b in spans]))
    begins = {a for a, _ in spans if a % length == 0}
    if rows % length or len(begins) < MOSTLY * max(rows / length, len(spans)):
        return spans
    return [(a, a + length) for a in range(0, rows, length)]


def _rms_about_mean(values: FloatArray) -> float:
    return float(np.sqrt(values.var(axis=0).sum()))


def _means(values: FloatArray | None, spans: list[Span]) -> FloatArray | None:
    """Return (n,) mean of the known values in each span; None unless every span has some."""
    if values is None:
        return None
    known = [values[a:b][np.isfinite(values[a:b])] for a, b in spans]
    if not all(len(part) for part in known):
        return None
    return np.array([part.mean() for part in known], dtype=np.float64)
