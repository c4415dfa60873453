"""The paper's filters and the tuned one side by side on one log: jitter at rest, lag and offset in moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.estimation.filter_bank import Filter, Run, filter_bank
from calrig.estimation.intervals import SETTLE_S, Intervals, find_intervals, segments_of
from calrig.estimation.jitter import Jitter, jitter
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.transient_response import MoveReference, Transient, move_reference, transient

NO_REST = (
    f"it does not stand long enough (over {SETTLE_S:g} s) or is not sampled fast enough (30 Hz) for jitter"
)
NO_MOVE = "no move of 1° or more with rest on either side: lag and offset are not known"


@dataclass(frozen=True, slots=True)
class FilterRow:
    """One filter's figures.

    Attributes:
        name, label, causal: see `Filter`.
        jitter: how it trembles at rest; None where that is not known.
        transient: how it follows moves; None where that is not known.
        reasons: why a figure is not known.
    """

    name: str
    label: str
    causal: bool
    jitter: Jitter | None = None
    transient: Transient | None = None
    reasons: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, str | bool | float | list[str] | None]:
        """The row flat, for JSON and tables: a figure that is not known is None."""
        trembles, follows = self.jitter, self.transient
        return {
            "name": self.name,
            "label": self.label,
            "causal": self.causal,
            "jitter_deg": trembles.std_deg if trembles else None,
            "jitter_peak_to_peak_deg": trembles.peak_to_peak_deg if trembles else None,
            "jitter_step_deg": trembles.step_deg if trembles else None,
            "lag_ms": follows.lag_ms if follows else None,
            "lag_std_ms": follows.lag_std_ms if follows else None,
            "largest_offset_deg": follows.largest_offset_deg if follows else None,
            "reasons": list(self.reasons),
        }


@dataclass(frozen=True, slots=True, eq=False)
class FilterComparison:
    """All filters on one log.

    Attributes:
        rows: one a filter, `raw` first.
        reference: what the moves are compared with, in words; empty without a move.
        moves: the moves and where the sensor was in them; their `judged` are indices into `time_s`.
        static: the intervals at rest in which jitter is taken, likewise.
        dropped: samples left out because something in them is not finite.
        time_s: (n,) of the samples left.
        filtered_deg: by name, (n,) each, continuous within a segment; NaN where a filter has no value.
    """

    rows: tuple[FilterRow, ...]
    reference: str
    moves: tuple[MoveReference, ...]
    static: tuple[slice, ...]
    dropped: int
    time_s: FloatArray
    filtered_deg: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Log:
    """Finite samples, the elevation unwrapped within every segment between gaps."""

    time_s: FloatArray
    elevation_deg: FloatArray
    rate_dps: FloatArray | None
    true_deg: FloatArray | None
    segments: list[slice]


def compare_filters(
    time_s: npt.ArrayLike,
    elevation_deg: npt.ArrayLike,
    rate_dps: npt.ArrayLike | None = None,
    *,
    tuned: KalmanNoise | None = None,
    gyro_scale: float = 1.0,
    true_deg: npt.ArrayLike | None = None,
) -> FilterComparison:
    """Runs every filter over a log and measures each on the same samples.

    Every segment between gaps is filtered by itself, and counts from `SETTLE_S` after its beginning. Jitter
    is taken where the sensor stands, lag and offset where it is turned, against `move_reference`.

    Args:
        time_s: (n,) the board's clock, strictly increasing.
        elevation_deg: (n,) elevation of the accelerometer.
        rate_dps: (n,) rate about the axis of elevation; None or all NaN where there is no gyro.
        tuned: the unit's own noise (`tuned_noise`); the filter is driven by the rate between samples.
        gyro_scale: the unit's, of its calibration: what its rate is multiplied by for the tuned filter.
        true_deg: (n,) where the sensor was, on the elevation's turn, if known better than from the log.

    Raises:
        ValueError: shapes that differ, time that does not go forward, no finite sample.
    """
    log, dropped = _finite(time_s, elevation_deg, rate_dps, true_deg)
    seen = [find_intervals(log.time_s, log.elevation_deg, log.rate_dps, segment) for segment in log.segments]
    static = tuple(one for intervals in seen for one in intervals.static)
    moves = tuple(
        move
        for segment, intervals in zip(log.segments, seen, strict=True)
        for move in _references(log, segment, intervals)
    )
    rows, filtered = [], {}
    for one in filter_bank(with_gyro=log.rate_dps is not None, tuned=tuned, gyro_scale=gyro_scale):
        if one.run is None:
            rows.append(FilterRow(one.name, one.label, one.causal, reasons=(one.reason,)))
            continue
        filtered[one.name] = angle = _filtered(one.run, log)
        rows.append(_row(one, log.time_s, angle, static, moves))
    return FilterComparison(
        rows=tuple(rows),
        reference=_reference_words(log) if moves else "",
        moves=moves,
        static=static,
        dropped=dropped,
        time_s=log.time_s,
        filtered_deg=filtered,
    )


def _finite(
    time_s: npt.ArrayLike,
    elevation_deg: npt.ArrayLike,
    rate_dps: npt.ArrayLike | None,
    true_deg: npt.ArrayLike | None,
) -> tuple[_Log, int]:
    time, elevation = (np.asarray(x, dtype=np.float64) for x in (time_s, elevation_deg))
    rate, true = (None if x is None else np.asarray(x, dtype=np.float64) for x in (rate_dps, true_deg))
    if rate is not None and not np.isfinite(rate).any():
        rate = None
    known = [x for x in (time, elevation, rate, true) if x is not None]
    if any(x.shape != (len(time),) for x in known):
        raise ValueError(
            f"arrays must be flat and equally long, not {', '.join(str(x.shape) for x in known)}"
        )
    kept = np.logical_and.reduce([np.isfinite(x) for x in known])
    if not kept.any():
        raise ValueError("not one sample of the log is finite in time, elevation and rate at once")
    time, elevation = time[kept], elevation[kept]
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if len(back):
        raise ValueError(
            f"time must go forward: {time[back[0]]:g} s is followed by {time[back[0] + 1]:g} s. Bring the "
            "log to even time first"
        )
    segments = segments_of(time)
    for segment in segments:
        elevation[segment] = np.unwrap(elevation[segment], period=360.0)
    rate = None if rate is None else rate[kept]
    true = None if true is None else true[kept]
    return _Log(time, elevation, rate, true, segments), int(np.count_nonzero(~kept))


def _references(log: _Log, segment: slice, intervals: Intervals) -> list[MoveReference]:
    """The references of a segment's moves that begin late enough for the filters to have settled."""
    begins = [segment.start, *(one.stop for one in intervals.dynamic)]
    ends = [*(one.start for one in intervals.dynamic), segment.stop]
    references = []
    for index, disturbed in enumerate(intervals.dynamic):
        settled = log.time_s[disturbed.start] >= log.time_s[segment.start] + SETTLE_S
        if not (settled and disturbed in intervals.moves):
            continue
        room = slice(begins[index], ends[index + 1])
        move = move_reference(log.time_s, log.elevation_deg, log.rate_dps, disturbed, room)
        if move is not None and log.true_deg is not None:
            turns = np.rint((log.true_deg[room] - log.elevation_deg[room]).mean() / 360.0)
            move = MoveReference(move.judged, log.time_s[room], log.true_deg[room] - 360.0 * turns)
        if move is not None:
            references.append(move)
    return references


def _filtered(run: Run, log: _Log) -> FloatArray:
    rate = log.rate_dps
    return np.concatenate(
        [run(log.time_s[s], log.elevation_deg[s], None if rate is None else rate[s]) for s in log.segments]
    )


def _row(
    one: Filter,
    time_s: FloatArray,
    angle_deg: FloatArray,
    static: Sequence[slice],
    moves: Sequence[MoveReference],
) -> FilterRow:
    trembles, follows = jitter(time_s, angle_deg, static), transient(time_s, angle_deg, moves)
    reasons = (NO_REST,) * (trembles is None) + (NO_MOVE,) * (follows is None)
    return FilterRow(one.name, one.label, one.causal, trembles, follows, reasons)


def _reference_words(log: _Log) -> str:
    if log.true_deg is not None:
        return "the sensor's true angle, as given"
    if log.rate_dps is not None:
        return "the gyro's rate integrated over each move, fitted to the accelerometer at rest around it"
    return "the accelerometer's elevation through a low-pass at 5 Hz, forward and backward"


def tuned_against_paper(comparison: FilterComparison) -> str | None:
    """Whether the tuned filter beats the paper's constants on jitter and on lag, and if not, what it trades.

    Returns:
        None where one of the two was not run or stood nowhere.
    """
    rows = {row.name: row for row in comparison.rows}
    paper, tuned = rows["kalman_paper"], rows["kalman_tuned"]
    if paper.jitter is None or tuned.jitter is None:
        return None
    calmer = tuned.jitter.std_deg < paper.jitter.std_deg
    jitters = f"jitter ({tuned.jitter.std_deg:.2g}° against {paper.jitter.std_deg:.2g}° in 100 ms)"
    if paper.transient is None or tuned.transient is None:
        verb = "beats" if calmer else "does not beat"
        return f"The tuned filter {verb} the paper's constants on {jitters}; no move shows their lag."
    lag_ms, paper_ms = tuned.transient.lag_ms, paper.transient.lag_ms
    prompter = abs(lag_ms) < abs(paper_ms)
    lags = f"lag ({lag_ms:+.1f} ms against {paper_ms:+.1f} ms)"
    if calmer and prompter:
        return f"The tuned filter beats the paper's constants on {jitters} and on {lags} at once."
    if not (calmer or prompter):
        return f"The tuned filter beats the paper's constants on neither {jitters} nor {lags}."
    gained, given = (jitters, lags) if calmer else (lags, jitters)
    why = "; it trusts the gyro more, and with it the gyro's error of scale: calibrate that" if calmer else ""
    return f"The tuned filter is better than the paper's constants on {gained} and worse on {given}{why}."
