"""What a filter makes of a move: how late it comes, and how far it is off at worst.

Both need to know where the sensor really was. On a rig without an encoder's record, or on a bench, a record
knows that better than any filter running in it could: see `move_reference`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.estimation.intervals import SETTLE_S

_PIN_S = 2.0
_MIN_PIN_S = 0.4
_LOW_PASS_HZ = 5.0
_SCALE_RANGE = (0.5, 2.0)
_LONGEST_LAG_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class MoveReference:
    """Where the sensor was during one move.

    Attributes:
        judged: indices into the log over which a filter is compared with it: the move and `SETTLE_S` after.
        time_s: (m,) instants of the reference, from the rest before to the rest after.
        angle_deg: (m,) where it was then.
    """

    judged: slice
    time_s: FloatArray
    angle_deg: FloatArray


@dataclass(frozen=True, slots=True)
class Transient:
    """How a filter follows moves.

    Attributes:
        lag_ms: how late it comes (negative: early): the shift in time by which the reference fits it best in
            least squares, mean over the moves weighted by what each says of it.
        lag_std_ms: its standard error from the scatter between moves; None from a single one.
        largest_offset_deg: largest |filtered − reference| of any sample, noise included.
    """

    lag_ms: float
    lag_std_ms: float | None
    largest_offset_deg: float
    n_moves: int


def move_reference(
    time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray | None, move: slice, room: slice
) -> MoveReference | None:
    """Return where the sensor was during a move, from the record before, in and after it.

    With a gyro: the rate, less its mean while it stood before and after (and what drifted between), is
    integrated by trapezoids and stretched and shifted so that it agrees with the accelerometer's mean
    elevation over up to 2 s on either side. That has no delay, and neither the gyro's bias nor its scale
    enters. Without: the elevation through a Butterworth low-pass of second order at 5 Hz, forward and
    backward (Gustafsson, IEEE Trans. Signal Process. 44 (1996) 988), which has no delay either but rounds
    the corners of a move (0.1° at 80 °/s²).

    Args:
        time_s: (n,) strictly increasing.
        elevation_deg: (n,) continuous elevation of the accelerometer.
        rate_dps: (n,) rate about the axis of elevation; None where there is no gyro.
        move: indices of the move.
        room: indices around it that are free of gaps and other moves.

    Returns:
        None where it stands too briefly before or after to say where, or the gyro felt another turn.
    """
    interval_s = float(np.median(np.diff(time_s[room])))
    pin, least = round(_PIN_S / interval_s), max(3, round(_MIN_PIN_S / interval_s))
    begin, end = max(room.start, move.start - pin), min(room.stop, move.stop + pin)
    if move.start - begin < least or end - move.stop < least:
        return None
    judged = slice(move.start, min(end, move.stop + round(SETTLE_S / interval_s)))
    time, elevation = time_s[begin:end], elevation_deg[begin:end]
    if rate_dps is None:
        angle = _low_passed(elevation, interval_s)
    else:
        angle = _integrated(time, elevation, rate_dps[begin:end], move.start - begin, end - move.stop)
    return None if angle is None else MoveReference(judged, time, angle)


def transient(time_s: FloatArray, angle_deg: FloatArray, moves: Sequence[MoveReference]) -> Transient | None:
    """Return how a filter follows the moves of a log.

    Args:
        time_s: (n,) strictly increasing.
        angle_deg: (n,) what the filter gives, on the turn of the reference.
        moves: their references.

    Returns:
        None without a move that the filter went through.
    """
    lags, weights, offset_deg = [], [], 0.0
    for move in moves:
        time, angle = time_s[move.judged], angle_deg[move.judged]
        if not np.isfinite(angle).all():
            continue
        lag_s, weight = _lag(time, angle, move)
        lags.append(lag_s)
        weights.append(weight)
        offset_deg = max(offset_deg, float(np.abs(angle - _at(move, time)).max()))
    if not lags:
        return None
    share = np.array(weights) / math.fsum(weights)
    lag_s = float(share @ lags)
    scatter = float(share**2 @ (np.array(lags) - lag_s) ** 2)
    n = len(lags)
    std_ms = 1e3 * math.sqrt(scatter * n / (n - 1)) if n > 1 else None
    return Transient(1e3 * lag_s, std_ms, offset_deg, n)


def _at(move: MoveReference, time_s: FloatArray) -> FloatArray:
    return np.interp(time_s, move.time_s, move.angle_deg)


def _lag(time_s: FloatArray, angle_deg: FloatArray, move: MoveReference) -> tuple[float, float]:
    """Return the shift that fits best, by Gauss-Newton, and Σ rate², which is what the move says of it."""
    rate = np.gradient(move.angle_deg, move.time_s)
    lag_s, weight = 0.0, 0.0
    for _ in range(50):
        at = time_s - lag_s
        slope = np.interp(at, move.time_s, rate)
        weight = float(slope @ slope)
        step_s = -float(slope @ (angle_deg - _at(move, at))) / weight
        lag_s = min(max(lag_s + step_s, -_LONGEST_LAG_S), _LONGEST_LAG_S)
        if abs(step_s) < 1e-7:
            break
    return lag_s, weight


def _integrated(
    time_s: FloatArray, elevation_deg: FloatArray, rate_dps: FloatArray, before: int, after: int
) -> FloatArray | None:
    from scipy.integrate import cumulative_trapezoid

    head, tail = slice(0, before), slice(len(time_s) - after, None)

    def mean_at_ends(x: FloatArray) -> list[float]:
        return [float(x[head].mean()), float(x[tail].mean())]

    rate = rate_dps - np.interp(time_s, mean_at_ends(time_s), mean_at_ends(rate_dps))
    turned = cumulative_trapezoid(rate, time_s, initial=0)
    (turned_from, turned_to), (from_deg, to_deg) = mean_at_ends(turned), mean_at_ends(elevation_deg)
    scale = (to_deg - from_deg) / (turned_to - turned_from) if turned_to != turned_from else math.inf
    if not _SCALE_RANGE[0] < scale < _SCALE_RANGE[1]:
        return None
    return np.asarray(from_deg + scale * (turned - turned_from), dtype=np.float64)


def _low_passed(elevation_deg: FloatArray, interval_s: float) -> FloatArray | None:
    from scipy.signal import butter, sosfiltfilt

    if 2.0 * interval_s * _LOW_PASS_HZ >= 0.8:
        return None  # too slow a log for this
    sos = butter(2, _LOW_PASS_HZ, fs=1.0 / interval_s, output="sos")
    return np.asarray(sosfiltfilt(sos, elevation_deg), dtype=np.float64)
