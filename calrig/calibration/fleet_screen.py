"""Screen many runs at once for those in which a diagnosis could find an effect.

The poses of all runs are packed into arrays, and runs of one number of poses are worked on together: bias and
scale, then the residual's squares along a fixed set of contrasts. A contrast is a direction in which an
effect of the catalogue, or an unnamed one, would show: approach, move, temperature, time, elevation, steps,
cycles. All contrasts have the same critical value, so that together they pass at most a share `LEVEL` of runs
whose noise is normal and independent from pose to pose, whatever their layout (Bonferroni's bound). Under
that null hypothesis the share R² of the residual's squares along a contrast of d columns has the exact
distribution B(d/2, (ν − d)/2), ν the residual's degrees of freedom (Draper & Smith, Applied Regression
Analysis, 1998, section 6.1). Noise that is correlated from pose to pose passes the screen: only a diagnosis,
which models it, can distinguish it from an effect.

As in the diagnosis, the first pose of a run and outliers are not tested.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.line import bias_on_turn_deg, follows_stage, reading_error_deg
from calrig.calibration.packed_poses import PackedPoses
from calrig.calibration.regression.responses import FEWEST_POSES
from calrig.estimation.angles import MAD_TO_STD, FloatArray, Intp, wrap_deg

Float32 = npt.NDArray[np.float32]
Complex64 = npt.NDArray[np.complex64]
TINY = np.finfo(np.float32).tiny
BEYOND = 5
"""Times the waves that as many places spread evenly resolve: as far as the diagnosis searches periods."""
NO_ARC = 1e-6
"""Below it the poses are at one elevation."""
PLACES = 8
"""Of the grid to a half period of the shortest wave, in two arcs: on the nearest of them it loses 5 %."""
FEWEST_BESIDE = 2
"""Poses on either side of a step."""
SINGULAR = 0.05
"""Of the square of the poses: a wave whose sine and cosine are as alike as that counts as one column."""
SHORTEST = 0.05
"""Squared length of a step that bias and scale nearly explain, below which it is no contrast."""


def steps(channel: Float32, tilted: Float32, squares: FloatArray) -> tuple[FloatArray, int]:
    """The largest share of squares along a step after any pose, bias and scale fitted beside it.

    Args:
        channel: (R, m) residuals that bias and scale have no part in any more.
        tilted: (R, m) the unit column of scale.
        squares: (R,) of the channel.

    Returns:
        (R,) the share, and how many contrasts were looked along.
    """
    m = channel.shape[1]
    k = np.arange(1, m)
    left = np.cumsum(channel, axis=1)[:, :-1]
    length = (k * (m - k) / m).astype(np.float32) - np.cumsum(tilted, axis=1)[:, :-1] ** 2
    inner = slice(FEWEST_BESIDE - 1, m - FEWEST_BESIDE)
    shares = left[:, inner] ** 2 / np.maximum(length[:, inner], SHORTEST)
    return shares.max(axis=1) / np.maximum(squares, TINY), shares.shape[1]


def cycles(channel: Float32, squares: FloatArray) -> tuple[FloatArray, int]:
    """The largest share along a cycle of whole half periods in the order of the poses; as `waves`."""
    from scipy import fft

    m = channel.shape[1]
    seen = fft.rfft(channel, 2 * m, axis=1)[:, 1:m]
    doubled = fft.fft(np.ones(m), 2 * m)[2::2].astype(np.complex64)
    return _gain_along(seen, doubled, m).max(axis=1) / np.maximum(squares, TINY), m - 1


def waves(channel: Float32, theta: Float32, squares: FloatArray) -> tuple[FloatArray, Intp]:
    """The largest share along a wave over elevation, of any whole number of half periods in the arc.

    Lomb's periodogram (Astrophysics and Space Science 39, 1976) by two fast transforms, of the residuals and
    of the poses, each laid on the nearest place of a fine grid. What bias and scale take of a wave is not
    added back, so that the share is at most what it is beside them.

    Args:
        channel: (R, m) residuals.
        theta: (R, m) elevations, in any unit.
        squares: (R,) of the channel.

    Returns:
        (R,) the share, and how many contrasts were looked along in each run: poses at few elevations tell
        fewer waves apart.
    """
    from scipy import fft

    runs, m = channel.shape
    n_waves = BEYOND * m
    n_grid = fft.next_fast_len(PLACES * n_waves, real=True)
    least = theta.min(axis=1)[:, None]
    arc = theta.max(axis=1)[:, None] - least
    arc = np.where(arc > NO_ARC, arc, np.float32(1.0))
    place = np.rint((theta - least) * ((n_grid // 2 - 1) / arc)).astype(np.intp)
    place += n_grid * np.arange(runs)[:, None]

    def on_grid(values: Float32 | None) -> Float32:
        weights = None if values is None else values.ravel()
        laid = np.bincount(place.ravel(), weights, runs * n_grid).reshape(runs, n_grid)
        return laid.astype(np.float32)

    poses = on_grid(None)
    resolved = BEYOND * np.count_nonzero(poses, axis=1)
    seen = fft.rfft(on_grid(channel), axis=1)[:, 1 : n_waves + 1]
    shares = _gain_along(seen, fft.rfft(poses, axis=1)[:, 2 : 2 * n_waves + 1 : 2], m)
    shares[np.arange(n_waves) >= resolved[:, None]] = 0.0
    return shares.max(axis=1) / np.maximum(squares, TINY), resolved


def _gain_along(seen: Complex64, doubled: Complex64, m: int) -> FloatArray:
    """(R, w) sums of squares along w waves, each by least squares of its sine and cosine.

    Args:
        seen: (R, w) Σ e·exp(−ix) over the m poses of a run, at the phases x of a wave.
        doubled: (R, w) or (w,) Σ exp(−2ix).
        m: how many poses.
    """
    a, b, c2, s2 = seen.real, seen.imag, doubled.real, doubled.imag
    both = a * a + b * b
    determinant = m * m - (c2 * c2 + s2 * s2)
    fitted = 2.0 * (m * both - c2 * (a * a - b * b) - 2.0 * s2 * a * b)
    is_pair = determinant > SINGULAR * m * m
    return np.where(is_pair, fitted / np.maximum(determinant, 1.0), both / m)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The lines through R runs of n poses each.

    Attributes:
        theta_deg: (R, n) elevations.
        given: the other columns of the poses by name, (R, n) each; `covariates` are those without physics.
        left_deg: (R, n) readings less the line.
        bias_deg, scale: (R,); NaN where all poses were commanded to one elevation, which tells no scale.
        scale_std: (R,) its standard error under white noise, 0 without a scale.
        rms_deg: (R,) of what is left.
    """

    theta_deg: FloatArray
    given: dict[str, FloatArray]
    covariates: Sequence[str]
    left_deg: FloatArray
    bias_deg: FloatArray
    scale: FloatArray
    scale_std: FloatArray
    rms_deg: FloatArray

    @property
    def residual_deg(self) -> FloatArray:
        """(R, n) what is left in degrees of elevation; NaN where the reading does not follow the stage."""
        factor = np.where(np.isnan(self.scale), 1.0, self.scale)
        factor = np.where(follows_stage(factor, self.scale_std, self.rms_deg), factor, np.nan)
        return np.asarray(self.left_deg / factor[:, None])

    @property
    def is_rounding(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(R,) whether nothing is left but what arithmetic leaves."""
        largest = np.maximum(360.0, np.abs(self.theta_deg).max(axis=1))
        arithmetic = self.theta_deg.shape[1] * np.finfo(np.float64).eps * largest
        return np.asarray(self.rms_deg <= arithmetic)


def lines_of(poses: PackedPoses, theta_deg: FloatArray, rows: Intp) -> Lines:
    """The lines of runs by least squares.

    `theta_deg` (N,) are the elevations of the packed poses, `rows` (R, n) the poses of each run.
    """
    theta = theta_deg[rows]
    given = {name: column[rows] for name, column in poses.columns.items()}
    error = reading_error_deg(theta, given["reading_deg"])
    centre, level = theta.mean(axis=1), error.mean(axis=1)
    off = theta - centre[:, None]
    power = (off * off).sum(axis=1)
    turns = (np.ptp(given["target_deg"], axis=1) > 0.0) & (power > 0.0)
    slope = np.divide((off * error).sum(axis=1), power, out=np.zeros(len(power)), where=turns)
    left = error - level[:, None] - slope[:, None] * off
    squares = (left * left).sum(axis=1)
    freedom = max(theta.shape[1] - 2, 1)
    variance = np.divide(squares / freedom, power, out=np.zeros(len(power)), where=turns)
    return Lines(
        theta_deg=theta,
        given=given,
        covariates=poses.covariates,
        left_deg=left,
        bias_deg=bias_on_turn_deg(level - slope * centre, theta, given["reading_deg"], error),
        scale=np.where(turns, 1.0 + slope, np.nan),
        scale_std=np.sqrt(variance),
        rms_deg=np.sqrt(squares / theta.shape[1]),
    )


OUTLIER_STD = 4.5
"""Robust standard deviations, at which a residual is cut off: one pose gone wrong neither hides an effect nor
makes one. One of 150,000 is as far off by chance."""
CUTS = 2
"""Times that a base is fitted to what is cut: a pose wrong by 200 standard deviations is then found."""


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
    angle = given["reading_deg"][:, 1:] - np.degrees(np.arctan2(y, z))
    angle = angle[:, :1] + wrap_deg(angle - angle[:, :1])
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
    itself and hides behind that, so the base is fitted to the cut values, and all values are compared with
    that fit again.
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


LEVEL = 0.05
"""Of runs of white noise that stand out, at most: five times what the diagnosis' gate lets pass, so that
little is lost here that would pass there."""
POSES_AT_ONCE = 2**14
"""What belongs to them stays in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """What R runs show at a glance; NaN where it is not known, or a run has too few poses.

    Attributes:
        bias_deg, scale: (R,) of the line through all poses; no scale where all are at one angle.
        rms_deg: (R,) of the residual about it.
        lag1_correlation: (R,) of the residual from pose to pose.
        direction_deg: (R,) mean residual after upward moves less that after downward moves.
        direction, temperature, time, elevation, motion, gravity, covariate: (R,) largest share of the squares
            along a contrast of that kind: of the residual, of the acceleration's magnitude (`gravity`), of
            the reading less the accelerometer's own angle (`motion`).
        p_value: (R,) bound on the chance that white noise shows as much in any contrast.
        residual_deg: (N,) (reading − bias)/scale − θ of each pose, as packed.
    """

    bias_deg: FloatArray
    scale: FloatArray
    rms_deg: FloatArray
    lag1_correlation: FloatArray
    direction_deg: FloatArray
    direction: FloatArray
    temperature: FloatArray
    time: FloatArray
    elevation: FloatArray
    motion: FloatArray
    gravity: FloatArray
    covariate: FloatArray
    p_value: FloatArray
    residual_deg: FloatArray

    @property
    def stands_out(self) -> npt.NDArray[np.bool_]:
        """(R,) whether a diagnosis could find something."""
        return self.p_value <= LEVEL


OF_LINES = ("bias_deg", "scale", "rms_deg")
OF_RUNS = tuple(field.name for field in fields(Screened) if field.name != "residual_deg")


def screen(poses: PackedPoses) -> Screened:
    """Screens runs, all that have as many poses together; each run's poses are in the order measured."""
    found = {name: np.full(len(poses), np.nan) for name in OF_RUNS}
    residual_deg = np.full(int(poses.first[-1]), np.nan)
    theta_deg = poses.theta_deg
    for runs in _alike(poses.counts):
        rows = poses.first[runs][:, None] + np.arange(poses.counts[runs[0]])
        lines = lines_of(poses, theta_deg, rows)
        residual_deg[rows] = lines.residual_deg
        judged = _of_block(lines) if rows.shape[1] >= FEWEST_POSES else {}
        found_here = {name: getattr(lines, name) for name in OF_LINES} | judged
        for name, values in found_here.items():
            found[name][runs] = values
    return Screened(**found, residual_deg=residual_deg)


def _alike(counts: Intp) -> Iterator[Intp]:
    """Runs of one number of poses each, as many at a time as are worked on together."""
    ordered = np.argsort(counts, kind="stable")
    for same in np.split(ordered, np.flatnonzero(np.diff(counts[ordered])) + 1):
        n = int(counts[same[0]]) if len(same) else 0
        if n > 0:
            at_once = max(1, POSES_AT_ONCE // n)
            yield from (same[k : k + at_once] for k in range(0, len(same), at_once))


def _of_block(lines: Lines) -> dict[str, FloatArray]:
    """(R,) each of `OF_RUNS` but the line's own."""
    block = Block.of(lines)
    shares = channel_shares(block)
    tested = 1 + sum(share.contrasts for share in shares)  # the correlation is one
    p_value = np.minimum(_p_of_correlation(block), np.min([_p_value(share) for share in shares], axis=0))
    by_kind: dict[str, FloatArray] = {}
    for share in shares:
        by_kind[share.kind] = np.maximum(by_kind.get(share.kind, share.largest), share.largest)
    return {
        "lag1_correlation": block.lag1_correlation,
        "direction_deg": block.direction_deg,
        **by_kind,
        "p_value": np.where(lines.is_rounding, 1.0, np.minimum(tested * p_value, 1.0)),
    }


def _p_value(share: Share) -> FloatArray:
    """(R,) chance that white noise has so large a share along one given contrast."""
    from scipy.special import betainc

    left = 1.0 - np.clip(share.largest, 0.0, 1.0)
    if share.columns == 2:
        return np.asarray(left ** ((share.freedom - 2) / 2.0))
    return np.asarray(betainc((share.freedom - 1) / 2.0, 0.5, left))


def _p_of_correlation(block: Block) -> FloatArray:
    """(R,) of a lag-1 correlation as far from what the line leaves of none, either way."""
    from scipy.special import ndtr

    off = block.lag1_correlation - block.lag1_expected
    return np.asarray(2.0 * ndtr(-np.abs(off) / block.lag1_std))
