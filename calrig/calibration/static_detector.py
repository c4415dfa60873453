"""Static poses in a log of samples, or in a table of positions, whether or not the rate is known.

If the rate is known, segments at rest are looked for over a second. Else the window is the one whose poses
agree best with |a| = 1 g: the smallest mean standard error of bias, scale and misalignment. It grows with
motion taken for rest (window too short) and with poses that are missed (window too long).
"""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.gravity_fit import (
    FEWEST_POSES,
    MISALIGNMENT,
    NORMAL_QUARTILE,
    Problem,
    consistent_poses,
    fit_gravity,
    largest_model,
    robust_scale_g,
    undetermined_base,
)
from calrig.calibration.static_segments import (
    GravityError,
    Span,
    StaticPoses,
    poses_of,
    position_spans,
    quiet_spans,
)
from calrig.estimation.angles import FloatArray

WINDOW_S = 1.0
SHORTEST_S = 1.5
EDGE_S = 0.25
FEWEST_IN_WINDOW = 8
NARROWEST = 4
"""Samples of the first window that is tried where no rate is known."""
WIDER = 1.5
AS_GOOD = 1.15
"""Windows whose mean standard error is at most so many times the best one's agree equally well."""
GOOD_ENOUGH = 4.0
"""The same of poses from a known rate or a table's own order: chance gives few poses a small residual."""
FEWEST_DEGREES = 3
MOST_POSITIONS = 5000
"""A longer table is a log."""
APART = 2.0
"""In robust residuals: nine of ten rows of a table of positions are further from the next; at rest, 1.1."""
OUTLYING_SHARE = 0.1


def static_poses(
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    rate_hz: float | None = None,
    gyro_dps: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
) -> StaticPoses:
    """Return the static poses of a log, or the positions of a table that has one or some rows of each.

    Args:
        accel_g: (N, 3) finite samples, N ≥ 1.
        time_s: (N,) not decreasing; None where not known.
        rate_hz: of the samples, instead of the one that `time_s` shows.
        gyro_dps: (N, 3): if it is known, it must not rotate either.
        temperature_c: (N,), NaN where not known.

    Raises:
        GravityError: the log is too short for a window, or is never static.
    """
    rows = len(accel_g)
    if rows < FEWEST_POSES:
        raise GravityError(
            f"too few rows ({rows}): at least {FEWEST_POSES} positions are needed (six unknowns, and "
            f"something to judge them by); add {FEWEST_POSES - rows} more with one row for each, or "
            "record a log of several seconds in each"
        )

    def means(spans: list[Span], finding: str, time_s: FloatArray | None = time_s) -> StaticPoses:
        return poses_of(spans, accel_g, time_s=time_s, temperature_c=temperature_c, finding=finding)

    if has_one_row_a_pose(accel_g):
        finding = "consecutive rows differ by far more than noise: taken as one row a position"
        return means([(k, k + 1) for k in range(rows)], finding)
    at_rate_s = time_s
    if rate_hz is not None:
        at_rate_s = np.arange(rows) / rate_hz
    elif time_s is not None:
        rate_hz = _rate_hz(time_s)
    stated: list[StaticPoses] = []
    reason = _never_static(rows)
    if rate_hz is not None:
        try:
            stated = [means(_spans_at_rate(accel_g, rate_hz, gyro_dps), "", at_rate_s)]
        except GravityError as error:
            reason = error
    if spans := position_spans(accel_g):
        is_slow = rate_hz is not None and WINDOW_S * rate_hz < FEWEST_IN_WINDOW
        stated.insert(0 if is_slow else len(stated), means(spans, _rows_each(spans)))
    tried: list[StaticPoses] = []
    if rate_hz is None or max(map(len, stated), default=0) < FEWEST_POSES:
        tried = [means(*one) for one in _spans_without_rate(accel_g, gyro_dps)]
    found = _best(stated, tried)
    if found is None:
        raise reason
    return found


def has_one_row_a_pose(accel_g: FloatArray) -> bool:
    """Return whether consecutive rows differ by far more than what no attitude explains of a row."""
    rows = len(accel_g)
    if rows > MOST_POSITIONS:
        return False
    poses = poses_of([(k, k + 1) for k in range(rows)], accel_g)
    if undetermined_base(poses):
        size_g = np.linalg.norm(accel_g, axis=1)
        scale_g = float(np.median(np.abs(size_g - np.median(size_g)))) / NORMAL_QUARTILE
    else:
        problem = Problem.of(poses)
        try:
            _, scale_g = robust_scale_g(problem, largest_model(problem))
        except GravityError:
            return False
    steps_g = np.linalg.norm(np.diff(accel_g, axis=0), axis=1)
    return bool(np.quantile(steps_g, 0.1) > APART * scale_g)


def outlier_limit(n_poses: int) -> int:
    """Return how many of n poses may disagree with the others before all are in doubt."""
    return int(OUTLYING_SHARE * n_poses)


def _spans_at_rate(accel_g: FloatArray, rate_hz: float, gyro_dps: FloatArray | None) -> list[Span]:
    width = max(FEWEST_IN_WINDOW, round(WINDOW_S * rate_hz))
    if len(accel_g) < 2 * width:
        raise GravityError(
            f"{len(accel_g)} samples are too few to find static poses in: gravity needs the log of samples, "
            f"at least {2 * width} of them (several seconds in every pose), or one row for each position"
        )
    shortest, edge = max(width, round(SHORTEST_S * rate_hz)), round(EDGE_S * rate_hz)
    return quiet_spans(accel_g, gyro_dps, width=width, shortest=shortest, edge=edge)


def _rows_each(spans: list[Span]) -> str:
    lengths = sorted({b - a for a, b in spans})
    rows = f"{lengths[0]} to {lengths[-1]}" if len(lengths) > 1 else f"{lengths[0]}"
    return f"no motion between the positions: taken as {len(spans)} positions of {rows} rows each"


def _spans_without_rate(accel_g: FloatArray, gyro_dps: FloatArray | None) -> Iterator[tuple[list[Span], str]]:
    width = NARROWEST
    while FEWEST_POSES * SHORTEST_S * width <= len(accel_g):
        shortest, edge = round(SHORTEST_S * width), round(EDGE_S * width)
        try:
            spans = quiet_spans(accel_g, gyro_dps, width=width, shortest=shortest, edge=edge)
        except GravityError:
            return  # a wider window is no quieter
        yield spans, f"the rate is not known: static segments found over {width} samples"
        width = round(WIDER * width)


def _best(stated: list[StaticPoses], tried: list[StaticPoses]) -> StaticPoses | None:
    """Return the poses that determine the sensor best.

    The first of `stated`, from the rate or from the table's own order, wins if it is nearly as good as the
    best. Of windows as good, those with the fewest poses that disagree win, of these the most poses, of these
    the middle window.
    """
    known = [(judged, poses) for poses in (*stated, *tried) if (judged := _judged(poses)) is not None]
    if not known:
        found = max((*stated, *tried), key=len, default=None)
        return found if found is not None and len(found) else None
    least = min(std for (std, _), _ in known)
    for (std, _), poses in known:
        if any(poses is one for one in stated) and std <= GOOD_ENOUGH * least:
            return poses
    good = [(-outliers, len(poses), poses) for (std, outliers), poses in known if std <= AS_GOOD * least]
    most = max((agreeing, count) for agreeing, count, _ in good)
    best = [poses for agreeing, count, poses in good if (agreeing, count) == most]
    return best[len(best) // 2]


def _judged(poses: StaticPoses) -> tuple[float, int] | None:
    """Return the geometric mean of the parameters' standard errors, and how many poses disagree.

    None where the poses do not determine the parameters, or too many of them disagree.
    """
    if len(poses) < FEWEST_POSES or undetermined_base(poses):
        return None
    problem = Problem.of(poses)
    try:
        kept, _ = consistent_poses(problem)
        effects = [effect for effect in largest_model(problem) if effect.name == MISALIGNMENT]
        fitted = fit_gravity(problem.rows(kept), effects)
    except GravityError:
        return None
    outliers, degrees = int((~kept).sum()), len(fitted.residual_g) - len(fitted.beta)
    sign, log_volume = np.linalg.slogdet(fitted.covariance)
    if outliers > outlier_limit(len(poses)) or sign <= 0.0 or degrees < FEWEST_DEGREES:
        return None
    return float(np.exp(0.5 * log_volume / len(fitted.beta))), outliers


def _rate_hz(time_s: FloatArray) -> float | None:
    """Return the rate that times tell; None where rows share them, as those of a position may."""
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return 1.0 / step if step > 0.0 else None


def _never_static(rows: int) -> GravityError:
    return GravityError(
        f"never static: {rows} rows are neither a log with poses at rest nor a table of positions; lay the "
        "sensor down for a few seconds in every pose, or write down one row for each position"
    )
