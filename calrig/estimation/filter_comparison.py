"""Compare the paper's smoothers and Kalman filter with the tuned one: jitter at rest, lag in moves.

Nirmal et al., Proc. SPIE 9912 (2016), doi:10.1117/12.2234255, section 4: a moving average of 10 samples and
Savitzky-Golay filters of 11 samples with orders 1, 2, 4 and 6. *Causal* is the value at the newest sample of
the window, which is what a controller has; *centred* is that in its middle, which only a record allows.
Smoothers take samples as evenly spaced: give one segment without a gap at a time.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.estimation.gains import filter_uniform
from calrig.estimation.intervals import SETTLE_S, Intervals, find_intervals, segments_of
from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.estimation.transient_response import MoveReference, Transient, move_reference, transient
from calrig.estimation.tuning import midpoint_rate_dps

MOVING_AVERAGE_WINDOW = 10
SAVITZKY_GOLAY_WINDOW = 11
SAVITZKY_GOLAY_ORDERS = (1, 2, 4, 6)


def moving_average(
    x: FloatArray, window: int = MOVING_AVERAGE_WINDOW, *, centred: bool = False
) -> FloatArray:
    """Return the mean of the last `window` samples, or of those around each sample.

    An even window has no middle sample. Centred, it spans window + 1 samples, the outer two with half weight,
    and so neither leads nor lags.

    `x` (n,) are evenly spaced; with `centred` the window is around each sample instead of up to it.

    Returns:
        (n,) with NaN where the window is not full.
    """
    if window < 1:
        raise ValueError(f"a window of {window} samples holds none")
    weights = np.full(window, 1.0 / window)
    if centred and window % 2 == 0:
        weights = np.convolve(weights, [0.5, 0.5])
    return _weighted(x, weights, len(weights) // 2 if centred else 0)


def savitzky_golay(
    x: FloatArray, order: int, window: int = SAVITZKY_GOLAY_WINDOW, *, centred: bool = False
) -> FloatArray:
    """Return a polynomial fitted to `window` samples, evaluated at the newest or in the middle.

    Savitzky & Golay, Anal. Chem. 36 (1964) 1627, through `scipy.signal.savgol_coeffs`. Centred, an odd order
    is the even one below it, and order 1 is the mean.

    Args:
        x: (n,) evenly spaced samples.
        order: of the polynomial, below `window`.
        window: how many samples, odd.
        centred: evaluated in the middle instead of at the newest sample.

    Returns:
        (n,) with NaN where the window is not full.

    Raises:
        ValueError: an order that the window cannot hold, an even window.
    """
    from scipy.signal import savgol_coeffs

    if window % 2 == 0 or not 0 <= order < window:
        raise ValueError(f"order {order} over {window} samples: the window must be odd and above the order")
    ahead = window // 2 if centred else 0
    weights = np.asarray(savgol_coeffs(window, order, pos=window - 1 - ahead), dtype=np.float64)
    return _weighted(x, weights, ahead)


def _weighted(x: FloatArray, weights: FloatArray, ahead: int) -> FloatArray:
    """Σ weights[j]·x[i + ahead − j]; NaN where that reaches beyond either end."""
    smoothed = np.full(len(x), np.nan)
    before = len(weights) - 1 - ahead
    if len(x) >= len(weights):
        # small numbers about the first sample: no rounding of a large angle
        smoothed[before : len(x) - ahead] = np.convolve(x - x[0], weights, mode="valid") + x[0]
    return smoothed


EVEN = 0.01
"""Intervals that differ from their mean by less than this share of it count as one."""
NO_GYRO = "the log has no rate about the axis of elevation, which this filter needs"
NOT_TUNED = "the noise of this unit's gyro and elevation is not known, from which it would be tuned"

Smoother = Callable[[FloatArray], FloatArray]
Run = Callable[[FloatArray, FloatArray, FloatArray | None], FloatArray]
"""Time, elevation and rate (or None) of one segment without a gap to the filtered angle."""


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter.

    Attributes:
        name: for programs: `raw`, `moving_average`, `savitzky_golay_2`, `kalman_paper`, `kalman_tuned`;
            `_centred` at the end where it looks ahead.
        label: for people.
        causal: whether a controller can run it.
        run: what it does to a segment; None where it cannot be run on this log.
        reason: why not.
    """

    name: str
    label: str
    causal: bool
    run: Run | None
    reason: str = ""


def filter_bank(*, with_gyro: bool, tuned: KalmanNoise | None, gyro_scale: float = 1.0) -> list[Filter]:
    """Return every filter, in the order in which tables and figures show them.

    `tuned` is the noise of the tuned filter, which is driven by `midpoint_rate_dps` times `gyro_scale`.
    """
    return [
        Filter("raw", "accelerometer alone", True, lambda _time, elevation, _rate: elevation),
        *_smoothers(),
        _kalman("kalman_paper", "Kalman, the paper's constants", with_gyro, KalmanNoise(), None),
        _kalman("kalman_tuned", "Kalman, tuned from the noise", with_gyro, tuned, gyro_scale),
    ]


def _smoothers() -> Iterator[Filter]:
    golay = f"Savitzky-Golay of {SAVITZKY_GOLAY_WINDOW}, order"
    kinds: list[tuple[str, str, Callable[..., FloatArray]]] = [
        ("moving_average", f"moving average of {MOVING_AVERAGE_WINDOW}", moving_average),
        *(
            (f"savitzky_golay_{order}", f"{golay} {order}", partial(savitzky_golay, order=order))
            for order in SAVITZKY_GOLAY_ORDERS
        ),
    ]
    for name, label, smooth in kinds:
        for centred in (False, True):
            yield Filter(
                name + "_centred" * centred,
                label + ", centred" * centred,
                not centred,
                _of_elevation(partial(smooth, centred=centred)),
            )


def _of_elevation(smooth: Smoother) -> Run:
    return lambda _time, elevation, _rate: smooth(elevation)


def _kalman(
    name: str, label: str, with_gyro: bool, noise: KalmanNoise | None, gyro_scale: float | None
) -> Filter:
    """Return a Kalman filter; with a `gyro_scale` it is driven by the scaled rate between samples."""
    if not with_gyro:
        return Filter(name, label, True, None, NO_GYRO)
    if noise is None:
        return Filter(name, label, True, None, NOT_TUNED)

    def run(time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray | None) -> FloatArray:
        if rate_dps is None:
            raise ValueError(NO_GYRO)
        rate = rate_dps if gyro_scale is None else gyro_scale * midpoint_rate_dps(rate_dps)
        return kalman_filtered(time_s, elevation_deg, rate, noise)

    return Filter(name, label, True, run)


def kalman_filtered(
    time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray, noise: KalmanNoise
) -> FloatArray:
    """Return the filtered angle of one segment, by the fast path where its intervals are `EVEN`."""
    steps = np.diff(time_s)
    if len(steps) and np.ptp(steps) <= EVEN * steps.mean():
        return filter_uniform(elevation_deg, rate_dps, float(steps.mean()), noise)
    return KalmanFilter(noise).run(time_s, elevation_deg, rate_dps)


BIN_S = 0.1
MIN_BIN_SAMPLES = 3
_FULL = 0.8
"""Share of the samples due that a bin must hold: one cut short says less than its neighbours."""


@dataclass(frozen=True, slots=True)
class Jitter:
    """Jitter of one signal, all in degrees.

    Attributes:
        std_deg: the jitter "per 100 ms" that filters are compared by: standard deviation (n − 1) about the
            mean of each bin, root-mean-square over the bins.
        peak_to_peak_deg: largest less smallest value within a bin, root-mean-square over the bins.
        step_deg: change of the mean from one bin to the next, root-mean-square (√2 times the Allan deviation
            at 100 ms): what a filter slower than a bin does, which the other two do not see.
    """

    std_deg: float
    peak_to_peak_deg: float
    step_deg: float | None
    n_bins: int


def jitter(
    time_s: FloatArray, angle_deg: FloatArray, static: Sequence[slice], bin_s: float = BIN_S
) -> Jitter | None:
    """Return the jitter of an angle over the segments in which the sensor stands.

    Nirmal et al., Proc. SPIE 9912 (2016), give 0.330° before and 0.143° after fusion "per 100 ms" and no
    formula; taken here is the one for which the raw figure is the noise of a single sample. Mean and slow
    drift of the angle do not enter it.

    Args:
        time_s: (n,) increasing.
        angle_deg: (n,) continuous; samples without a value (NaN) are passed over.
        static: intervals of the log, each cut into bins from its own beginning.
        bin_s: length of a bin.

    Returns:
        None where no bin is full: segments too short, or fewer than `MIN_BIN_SAMPLES` samples a bin.
    """
    variances, ranges, steps = [], [], []
    for segment in static:
        mean, variance, extent = _bins(time_s[segment], angle_deg[segment], bin_s)
        full = np.isfinite(mean)
        variances.append(variance[full])
        ranges.append(extent[full])
        step = np.diff(mean)
        steps.append(step[np.isfinite(step)])
    if not variances or not (n_bins := sum(len(one) for one in variances)):
        return None
    step_deg = _rms(np.concatenate(steps)) if any(len(one) for one in steps) else None
    std_deg = math.sqrt(float(np.concatenate(variances).mean()))
    return Jitter(std_deg, _rms(np.concatenate(ranges)), step_deg, n_bins)


def _bins(
    time_s: FloatArray, angle_deg: FloatArray, bin_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, variance and range of each bin in turn; NaN for one that is not full."""
    if len(time_s) < 2:
        return np.empty(0), np.empty(0), np.empty(0)
    start_s, due = float(time_s[0]), bin_s / float(np.median(np.diff(time_s)))
    known = np.isfinite(angle_deg)
    angle_deg = angle_deg[known]
    # half a millionth of a bin: a sample on the border by the decimals of its time belongs to the next
    index = np.floor((time_s[known] - start_s) / bin_s + 5e-7).astype(np.intp)
    mean, variance, extent = np.full((3, int(index[-1]) + 1 if len(index) else 0), np.nan)
    occupied, first, count = np.unique(index, return_index=True, return_counts=True)
    full = count >= max(MIN_BIN_SAMPLES, _FULL * due)
    if not full.any():
        return mean, variance, extent
    means = np.add.reduceat(angle_deg, first) / count
    squares = np.add.reduceat((angle_deg - np.repeat(means, count)) ** 2, first)
    ranges = np.maximum.reduceat(angle_deg, first) - np.minimum.reduceat(angle_deg, first)
    into = occupied[full]
    mean[into], extent[into] = means[full], ranges[full]
    variance[into] = squares[full] / (count[full] - 1)
    return mean, variance, extent


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(values @ values) / len(values))


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
        """Return the row flat, for JSON and tables: a figure that is not known is None."""
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
    """Run every filter over a log and measure each on the same samples.

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
    """Return the references of a segment's moves that begin late enough for the filters to have settled."""
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
