"""Static poses in a log of samples: the stretches in which nothing but the sensor's own noise moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray

BoolArray = npt.NDArray[np.bool_]

WINDOW_S = 1.0
SHORTEST_S = 1.5
EDGE_S = 0.25
"""Taken off both ends of a pose: a window notices motion only when enough of it has come in."""
RATE_WITHOUT_TIME_HZ = 100.0
FEWEST_IN_WINDOW = 8
QUIET_QUANTILE = 0.1
"""At least this share of a log's windows is taken to be static, and gives the noise."""
ABOVE_NOISE = 2.0
COARSEST_STEP_G = 0.01
"""Two decimals; of a log without any noise, what lies between its values is no step of the sensor's."""
TURNING_DPS = 1.0
"""A turn as slow and even as this shows in the gyro's mean and hardly in the accelerometer's spread."""
NOISIEST_G = 0.05
"""A sensor noisier than this at rest is not known; what is noisier moves."""
SAME_POSE_DEG = 2.0


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
    """

    accel_g: FloatArray
    temperature_c: FloatArray | None
    time_s: FloatArray | None
    spans: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.accel_g)

    def rows(self, chosen: BoolArray) -> StaticPoses:
        """Some of the poses."""
        return StaticPoses(
            self.accel_g[chosen],
            None if self.temperature_c is None else self.temperature_c[chosen],
            None if self.time_s is None else self.time_s[chosen],
            self.spans[chosen],
        )


def static_poses(
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    gyro_dps: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
) -> StaticPoses:
    """Find the static poses by the spread within a sliding window, against the log's own quiet windows.

    The static detector of Tedaldi, Pretto & Menegatti (ICRA 2014, section V), with the noise taken from the
    quietest tenth of the log instead of a static period that somebody has to begin with. Neighbouring
    stretches less than 2° apart are one pose that was knocked.

    Args:
        accel_g: (N, 3) finite samples.
        time_s: (N,) increasing; without it the samples are taken to come at 100 Hz.
        gyro_dps: (N, 3): where it is known, it must not turn either.
        temperature_c: (N,), NaN where not known.

    Raises:
        GravityError: the log is too short for a window, or is never static.
    """
    rate_hz = _rate_hz(time_s)
    width = max(FEWEST_IN_WINDOW, round(WINDOW_S * rate_hz))
    if len(accel_g) < 2 * width:
        raise GravityError(
            f"{len(accel_g)} samples are too few to find static poses in: gravity needs the log of samples, "
            f"at least {2 * width} of them (several seconds in every pose)"
        )
    spread = window_spread(accel_g, width)
    noise = float(np.quantile(spread, QUIET_QUANTILE))
    if noise > NOISIEST_G:
        raise GravityError(
            f"the log is never static: over {WINDOW_S:g} s the accelerometer changes by {noise * 1e3:.0f} mg "
            "even where it is quietest; lay the sensor down for a few seconds in every pose"
        )
    quiet = spread <= ABOVE_NOISE * noise + min(_step_of(accel_g), COARSEST_STEP_G)
    if gyro_dps is not None and np.isfinite(gyro_dps).all():
        quiet &= _unturned(gyro_dps, width, quiet)
    shortest, edge = max(width, round(SHORTEST_S * rate_hz)), round(EDGE_S * rate_hz)
    spans = _merged(accel_g, _stretches(quiet, width, edge, shortest))
    return StaticPoses(
        np.array([accel_g[a:b].mean(axis=0) for a, b in spans]).reshape(-1, 3),
        _means(temperature_c, spans),
        _means(time_s, spans),
        np.array(spans, dtype=np.intp).reshape(-1, 2),
    )


def window_spread(values: FloatArray, width: int) -> FloatArray:
    """Return (N − width + 1,) root of the summed variances of the (N, 3) values within each window."""
    centred = values - values.mean(axis=0)  # sums of squares below lose no digits to a common level
    variance = _window_mean(centred**2, width) - _window_mean(centred, width) ** 2
    return np.asarray(np.sqrt(np.maximum(variance.sum(axis=1), 0.0)), dtype=np.float64)


def _window_mean(values: FloatArray, width: int) -> FloatArray:
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return np.asarray((sums[width:] - sums[:-width]) / width, dtype=np.float64)


def _unturned(gyro_dps: FloatArray, width: int, quiet: BoolArray) -> BoolArray:
    """Windows in which the gyro, less its bias, does not turn; the bias is what most quiet windows have."""
    rate = _window_mean(gyro_dps, width)
    if quiet.any():
        rate = rate - np.median(rate[quiet], axis=0)
    return np.asarray(np.linalg.norm(rate, axis=1) <= TURNING_DPS, dtype=np.bool_)


def _rate_hz(time_s: FloatArray | None) -> float:
    if time_s is None or len(time_s) < 2:
        return RATE_WITHOUT_TIME_HZ
    step = float(np.median(np.diff(time_s)))
    if step <= 0.0:
        raise GravityError("the times of the samples do not increase: correct time_s, or leave it out")
    return 1.0 / step


def _step_of(accel_g: FloatArray) -> float:
    """The sensor's own step: a sensor at rest may toggle between two counts, or show no noise at all."""
    steps = [np.diff(np.unique(column)) for column in accel_g.T]
    return min((float(step.min()) for step in steps if len(step)), default=0.0)


def _stretches(quiet: BoolArray, width: int, edge: int, shortest: int) -> list[tuple[int, int]]:
    """Stretches of samples under quiet windows, less their edges, if long enough.

    Windows that share a sample are of one stretch; two poses a jump apart share none.
    """
    change = np.diff(np.concatenate([[0], quiet.astype(np.intp), [0]]))
    whole: list[tuple[int, int]] = []
    for first, last in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1, strict=True):
        begin, end = int(first), int(last) + width
        if whole and begin < whole[-1][1]:
            begin = whole.pop()[0]
        whole.append((begin, end))
    return [(a + edge, b - edge) for a, b in whole if b - a - 2 * edge >= shortest]


def _merged(accel_g: FloatArray, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the longer of two neighbours that point the same way: a knock makes no second pose."""
    kept: list[tuple[int, int]] = []
    for span in stretches:
        if kept and _apart_deg(accel_g, kept[-1], span) < SAME_POSE_DEG:
            kept[-1] = max(kept[-1], span, key=lambda s: s[1] - s[0])
        else:
            kept.append(span)
    return kept


def _apart_deg(accel_g: FloatArray, one: tuple[int, int], other: tuple[int, int]) -> float:
    a, b = (accel_g[first:last].mean(axis=0) for first, last in (one, other))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _means(values: FloatArray | None, spans: list[tuple[int, int]]) -> FloatArray | None:
    """Return (n,) mean of the known values in each span; None unless every span has some."""
    if values is None:
        return None
    known = [values[a:b][np.isfinite(values[a:b])] for a, b in spans]
    if not all(len(part) for part in known):
        return None
    return np.array([part.mean() for part in known], dtype=np.float64)
