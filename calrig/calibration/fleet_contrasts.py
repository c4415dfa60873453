"""What the screen of a fleet looks along: runs of one number of poses as matrices, and their contrasts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.fleet_lines import Lines
from calrig.calibration.fleet_scans import cycles, steps, waves
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.estimation.robust import MAD_TO_STD

OUTLIER_STD = 4.5
"""Robust standard deviations, at which a residual is cut off: one pose gone wrong neither hides an effect nor
makes one. One of 150,000 is as far off by chance."""
CUTS = 2
"""Times that a base is fitted to what is cut: a pose wrong by 200 standard deviations is then found."""
Float32 = npt.NDArray[np.float32]


class Share(NamedTuple):
    """The largest share (R,) of a channel's squares along any of some contrasts of `columns` columns each.

    `kind` is a field of `Screened`; `contrasts` (R,) or a number counts those that a run has; `freedom` are
    the degrees of freedom of what the channel's base leaves.
    """

    kind: str
    largest: FloatArray
    contrasts: npt.NDArray[np.intp] | int
    columns: int
    freedom: int


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """What is judged of R runs of m + 1 poses each: all but the first of a run, matrices (R, m).

    Attributes:
        lag1_correlation: (R,) of the reading's residual.
        lag1_expected: (R,) of white noise, of which the line took its part; `lag1_std` is about it.
        direction_deg: (R,) as `fleet_screen.Screened`.
        theta: elevation, radians.
        line: orthonormal columns of bias and scale.
        channels: what is judged, by name: `reading`, and where known `norm` (the acceleration's magnitude)
            and `lag` (the reading less the accelerometer's angle), each in units of its own size, with
            nothing of its base left in it.
        known: further quantities by name.
        covariates: names of those that calrig has no physics for.
        warmth: temperature less its mean, over its norm.
    """

    lag1_correlation: FloatArray
    lag1_expected: FloatArray
    lag1_std: float
    direction_deg: FloatArray
    theta: Float32
    line: Sequence[Float32]
    channels: dict[str, Float32]
    known: dict[str, Float32]
    covariates: Sequence[str]
    warmth: Float32

    @classmethod
    def of(cls, lines: Lines) -> Block:
        """Of the runs that these lines are through."""
        judged = lines.theta_deg[:, 1:]
        m = judged.shape[1]
        ones = np.full(judged.shape, m**-0.5, dtype=np.float32)
        tilted = _normal(_less(judged - judged.mean(axis=1)[:, None], [ones]))
        line = [ones, tilted]
        known = dict(_quantities(lines.theta_deg, lines.given, lines.covariates))
        warmth = _normal(known["temperature_c"])
        reading = _judged(lines.left_deg[:, 1:], line)
        squares = np.maximum(_dot(reading, reading), np.finfo(np.float32).tiny)
        return cls(
            lag1_correlation=_dot(reading[:, 1:], reading[:, :-1]) / squares,
            lag1_expected=-((m - 1) / m + _dot(tilted[:, 1:], tilted[:, :-1])) / (m - 2),
            lag1_std=(m - 2) / (m * (m - 1.0) ** 0.5),
            direction_deg=_difference(lines.left_deg[:, 1:], known["approach"]),
            theta=np.radians(judged).astype(np.float32),
            line=line,
            channels={"reading": reading, **dict(_witnesses(lines.given, line, warmth))},
            known=known,
            covariates=lines.covariates,
            warmth=warmth,
        )


def channel_shares(block: Block) -> list[Share]:
    """Each channel along each kind of contrast."""
    reading, known = block.channels["reading"], block.known
    m = reading.shape[1]
    s, c = np.sin(block.theta), np.cos(block.theta)
    around = {"sin": s, "cos": c, "sin 2": 2.0 * s * c, "cos 2": c * c - s * s}
    warm = block.warmth
    of_reading: dict[str, list[Float32]] = {
        "direction": [known["approach"]],
        "motion": [known["move_deg"]],
        "temperature": [warm, warm * s, warm * c, warm * around["sin 2"]],
        "time": [known["time"], known["log_time"]],
        "elevation": [_scaled(block.theta) ** 2, _scaled(block.theta) ** 3],
        "covariate": [known[name] for name in block.covariates],
    }
    found = [
        _along(kind, reading, columns, block.line, m - 2) for kind, columns in of_reading.items() if columns
    ]
    squares = _dot(reading, reading)
    tilted = block.line[1]
    found += [
        Share("time", *steps(reading, tilted, squares), 1, m - 2),
        Share("time", *cycles(reading, squares), 2, m - 2),
        Share("elevation", *waves(reading, block.theta, squares), 2, m - 2),
    ]
    if "norm" in block.channels:
        columns = [*around.values(), *(warm * column for column in around.values())]
        base = [block.line[0], warm]
        found.append(_along("gravity", block.channels["norm"], columns, base, m - 2))
    if "lag" in block.channels:
        columns = [known["move_deg"], known["approach"]]
        found.append(_along("motion", block.channels["lag"], columns, block.line, m - 2))
    return found


def _along(
    kind: str, channel: Float32, columns: Sequence[Float32], base: Sequence[Float32], freedom: int
) -> Share:
    """The largest share of a channel's squares along any of the columns (R, m), each beside the base."""
    squares = np.maximum(_dot(channel, channel), np.finfo(np.float32).tiny)
    largest, contrasts = np.zeros(len(channel)), np.zeros(len(channel), dtype=np.intp)
    for column in columns:
        beside = _normal(_less(column, base))
        along = _dot(channel, beside)
        largest = np.maximum(largest, along**2 / squares)
        contrasts += along != 0.0  # it is where the column, or the channel, is not known
    return Share(kind, largest, contrasts, 1, freedom)


def _quantities(
    theta_deg: FloatArray, given: dict[str, FloatArray], covariates: Sequence[str]
) -> Iterator[tuple[str, Float32]]:
    """Columns (R, m) that effects are functions of; zero throughout where one is not known."""
    move = np.diff(theta_deg, axis=1)
    unknown = np.full(theta_deg.shape, np.nan)
    approach = given.get("approach", unknown)[:, 1:]
    approach = np.where(np.isnan(approach) | (approach == 0.0), np.sign(move), approach)
    time_s = given.get("time_s", unknown)
    ordinal = np.broadcast_to(np.arange(theta_deg.shape[1], dtype=np.float64), theta_deg.shape)
    is_known = ~np.isnan(time_s).any(axis=1, keepdims=True)
    time_s = np.where(is_known, time_s, ordinal)
    since = time_s[:, 1:] - time_s[:, :1]
    shortest = np.maximum(np.ptp(time_s, axis=1), 1e-9)[:, None] / (10.0 * theta_deg.shape[1])
    yield "approach", _centred(approach, scaled=False)
    yield "move_deg", _centred(move)
    yield "time", _centred(since)
    yield "log_time", _centred(np.log(np.maximum(since, shortest)))
    for name in ("temperature_c", *covariates):
        yield name, _centred(given.get(name, unknown)[:, 1:])


def _witnesses(
    given: dict[str, FloatArray], line: Sequence[Float32], warmth: Float32
) -> Iterator[tuple[str, Float32]]:
    """The acceleration's magnitude, and the reading less the accelerometer's angle, where they are known."""
    if "accel_y_g" not in given or "accel_z_g" not in given:
        return
    y, z = given["accel_y_g"][:, 1:], given["accel_z_g"][:, 1:]
    x = np.nan_to_num(given["accel_x_g"][:, 1:]) if "accel_x_g" in given else 0.0
    norm = np.nan_to_num(_off_mean(np.sqrt(x * x + y * y + z * z)))
    yield "norm", _judged(norm, [line[0], warmth])
    angle = wrap_deg(given["reading_deg"][:, 1:] - np.degrees(np.arctan2(y, z)))
    yield "lag", _judged(np.nan_to_num(_off_mean(angle)), line)


def _difference(left: FloatArray, approach: Float32) -> FloatArray:
    """(R,) mean after upward less mean after downward moves; NaN where there are none of either."""
    up = approach > 0.0
    n_up, n = up.sum(axis=1), left.shape[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        after_up = np.where(up, left, 0.0).sum(axis=1)
        return np.asarray(after_up / n_up - (left.sum(axis=1) - after_up) / (n - n_up))


def _off_mean(values: FloatArray) -> FloatArray:
    """(R, m) values less the mean of those of their run that are known."""
    known = ~np.isnan(values)
    total = np.where(known, values, 0.0).sum(axis=1)
    return np.asarray(values - (total / np.maximum(known.sum(axis=1), 1))[:, None])


def _centred(values: FloatArray, *, scaled: bool = True) -> Float32:
    """(R, m) the same about their mean, of order 1; what is not known, and what never changes, is 0."""
    off = np.nan_to_num(_off_mean(values))
    if scaled:
        off /= np.maximum(np.abs(off).max(axis=1), np.finfo(np.float32).tiny)[:, None]
    return off.astype(np.float32)


def _scaled(theta: Float32) -> Float32:
    """(R, m) elevation about its mean, in halves of its arc: powers of it stay of order 1."""
    off = theta - theta.mean(axis=1)[:, None]
    return np.asarray(off / np.maximum(np.abs(off).max(axis=1), np.finfo(np.float32).tiny)[:, None])


def _judged(values: npt.NDArray[np.floating], base: Sequence[Float32]) -> Float32:
    """(R, m) what the base leaves of values over their size, without what is far beyond the others of a run.

    Values beyond `OUTLIER_STD` times the spread are brought back to it. One of them draws the base towards
    itself and hides behind that, so the base is fitted to what is left of it, and all are held against that,
    anew.
    """
    size = np.maximum(np.abs(values).max(axis=1), np.finfo(np.float64).tiny)[:, None]
    left = _less(values / size, base)
    for _ in range(CUTS):
        cut = _cut(left)
        kept = _less(cut, base)
        left = left - (cut - kept)
    return _less(_cut(left), base)


def _cut(values: Float32) -> Float32:
    middle = values.shape[1] // 2
    spread = MAD_TO_STD * np.partition(np.abs(values), middle, axis=1)[:, middle, None]
    bound = np.where(spread > 0.0, OUTLIER_STD * spread, np.float32(np.inf))
    return np.asarray(np.clip(values, -bound, bound), dtype=np.float32)


def _dot(a: Float32, b: Float32) -> FloatArray:
    """(R,) products of rows."""
    return np.asarray(np.einsum("ij,ij->i", a, b), dtype=np.float64)


def _less(values: npt.NDArray[np.floating], base: Sequence[Float32]) -> Float32:
    """(R, m) what orthonormal columns leave of values."""
    left = values.astype(np.float32)
    for column in base:
        left = left - np.einsum("ij,ij->i", left, column)[:, None] * column
    return left


def _normal(column: Float32) -> Float32:
    """(R, m) of length 1; zero where next to nothing was left of a column of order 1."""
    length = np.sqrt(_dot(column, column))
    kept = length > LITTLE * column.shape[1] ** 0.5
    factor = np.divide(1.0, length, out=np.zeros_like(length), where=kept)
    return column * factor.astype(np.float32)[:, None]


LITTLE = 1e-4
"""Of a column of order 1, beside the base: what single precision leaves of one that the base explains."""
