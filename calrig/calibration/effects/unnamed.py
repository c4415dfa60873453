"""Structure that no effect of the catalogue explains, against any column: smooth, kink, step, cycle in time.

The unit at the end of a column's name (`azimuth_deg`, `supply_v`) says how it may act: an angle is a circle.
Where times are known, its rate and its delay are tried as well, and the product of two columns once both are
in the model.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from calrig.calibration.effects.stage_periodic import TURN_DEG, spacing_deg, steps_of
from calrig.calibration.regression.channels import ANGLE, MOVE, READING
from calrig.calibration.regression.column_units import TIMES, is_circle, unit_of_column
from calrig.calibration.regression.effect import (
    ELEVATION,
    LAST_MOVE,
    ApplyError,
    Covariate,
    Documents,
    Effect,
    Parameter,
    Parameters,
    Shape,
    Wording,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.spline import (
    FEWEST_KNOTS,
    NaturalSplines,
    SplineCurve,
    bent_columns,
    curve_document,
    natural_spline,
)
from calrig.calibration.regression.terms import (
    amplitude_and_phase,
    covered,
    goes_round,
    is_time_elevation,
    size_deg,
    tilted,
    turned,
    turns,
)
from calrig.estimation.angle_text import number_text
from calrig.estimation.angles import FloatArray, Intp

LEAST_ARC_DEG = 90.0
"""Over less of a circle its sines are what a smooth curve is."""
DELAYS = 5
MOST_FACTORS = 6
"""Columns of which all products are looked at."""


def standardised(column: FloatArray) -> FloatArray:
    """Return a column less its mean, over its standard deviation."""
    return np.asarray((column - column.mean()) / column.std(), dtype=np.float64)


def circle(column_deg: FloatArray, orders: int) -> FloatArray:
    """Return (n, 2·orders) sines and cosines of an angle's multiples."""
    angles = np.radians(column_deg)[:, None] * np.arange(1, orders + 1)
    waves = np.stack([np.sin(angles), np.cos(angles)], axis=2)
    return np.asarray(waves.reshape(len(column_deg), -1), dtype=np.float64)


def rate(r: Responses, name: str) -> FloatArray | None:
    """Return (n,) change of a column per second; None without times that advance within each run."""
    column, runs = _continuous(r, name), _runs(r)
    if runs is None:
        return None
    return np.concatenate([np.gradient(column[run], runs_time_s) for run, runs_time_s in runs])


def delays_s(r: Responses) -> FloatArray:
    """Time constants worth trying: from two poses to a third of a run."""
    runs = _runs(r)
    if runs is None:
        return np.empty(0)
    shortest = 2.0 * float(np.median(np.concatenate([np.diff(time_s) for _, time_s in runs])))
    longest = max(float(np.ptp(time_s)) for _, time_s in runs) / 3.0
    return np.geomspace(shortest, longest, DELAYS) if longest > shortest else np.empty(0)


def delayed(r: Responses, name: str, lag_s: float) -> FloatArray | None:
    """(n,) a column behind a first-order lag: y' = (z − y)/lag, z straight between poses, y = z at first.

    None without times that advance within each run.
    """
    column, runs = _continuous(r, name), _runs(r)
    if runs is None:
        return None
    behind = np.array(column)
    for run, time_s in runs:
        z = column[run]
        step_s = np.diff(time_s)
        kept = np.exp(-step_s / lag_s)
        slope = np.diff(z) / step_s
        for k in range(1, len(z)):  # exact for a straight z: y − (z − slope·lag) decays
            first = run.start + k
            off = behind[first - 1] - (z[k - 1] - slope[k - 1] * lag_s)
            behind[first] = z[k] - slope[k - 1] * lag_s + off * kept[k - 1]
    return behind


def products(r: Responses) -> Iterator[tuple[str, tuple[str, ...], FloatArray]]:
    """Name, factors to be in the model before, and (n, p) columns of products of two columns.

    One may be the temperature, or the elevation, whose scale is in every model.
    """
    known = {"temperature_c": r.temperature_c, "target_deg": r.theta_deg}
    factors = {name: column for name, column in known.items() if column is not None and np.ptp(column) > 0.0}
    factors.update(r.covariates)
    if len(r.covariates) > MOST_FACTORS:
        return
    for one, other in combinations(factors, 2):
        if one in r.covariates or other in r.covariates:
            a, b = _as_factor(one, factors), _as_factor(other, factors)
            factors_before = () if "target_deg" in (one, other) else (one, other)
            yield f"{one}{TIMES}{other}", factors_before, (a[:, :, None] * b[:, None, :]).reshape(len(r), -1)


def _as_factor(name: str, columns: Mapping[str, FloatArray]) -> FloatArray:
    column = columns[name]
    if name != "target_deg" and is_circle(name) and covered(column) >= LEAST_ARC_DEG:
        return circle(column, 1)
    return standardised(column)[:, None]


def _continuous(r: Responses, name: str) -> FloatArray:
    """Return a column whose steps are what happened: an angle does not jump by a turn."""
    column = r.covariates[name]
    return np.degrees(np.unwrap(np.radians(column))) if is_circle(name) else column


def _runs(r: Responses) -> list[tuple[slice, FloatArray]] | None:
    """Return each run and its times; None where they are not known or do not advance."""
    if r.time_s is None:
        return None
    ends = [*(1 + np.flatnonzero(r.starts[1:])), len(r)]
    runs, first = [], 0
    for end in ends:
        time_s = r.time_s[first:end]
        if len(time_s) < 2 or (np.diff(time_s) <= 0.0).any():
            return None
        runs.append((slice(first, int(end)), time_s))
        first = int(end)
    return runs


KNOTS = (3, 5)
MORE_KNOTS, POSES_A_KNOT = (9, 17, 33), 12
"""Of the elevation, where there are so many poses to each: a potentiometer may be wavy all along."""
OF_THE_READING = ", of the reading alone"
AT_EACH_PLACE = "any value at each angle"
ALTERNATING = "alternating from step to step"
UNSTEADY = "from pose to pose"
ALIKE_NEARBY = 0.25
"""Correlation of what poses have next to each other, beyond which it follows the place, and is no error."""
WAVE_BY_SIDE, BY_SIDE = "wave, by side", f"approach{TIMES}"
"""Of what changes sign with the approach: the form of a wave, and how its column's name begins."""
CIRCLE, CIRCLE_2 = "circle, order 1", "circle, orders 1 and 2"
KINK, STEP, OF_THE_STAGE = "kink", "step", ", of the stage"
PLACES, NEARBY = np.linspace(0.06, 0.94, 23), 0.06
"""Quantiles of a column that are scanned for a kink or step; how far about the best it is refined."""
FINE, GAPS = 1e-4, 9
"""Of that stretch, to which a kink is placed; gaps within it that are tried for a step at once."""
FEWEST_VALUES = 8
FEWEST_PLACES, MOST_PLACES, VISITS, ONE_OF_FEW = 4, 12, 4, 0.1
"""Places of a curve that may have any value at each, the fewest poses to each, and how near these are to each
other, of the widest gap between places."""
ONE_PLACE = 1e-3
"""Of a column's range: a stage that comes back to a place is as far off."""
MOST_CYCLES = 60.0
"""A run is searched for cycles in time up to this many, or as many as its poses can show."""
UNEQUAL = 0.5
"""Of the longest move, by how much moves differ that tell an overshoot from what comes with direction."""
ALIKE_STROKES = 0.9
"""Of a cycle in time, the share beyond which curves of the elevation and its direction explain it."""
Shares = Callable[[FloatArray], Mapping[str, FloatArray]]


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    """Return every covariate's flexible shapes; whoever knows the place of one takes the nearest."""
    if turns(r):
        yield from _of_elevation(r, at)
        of_turn = [TURN_DEG] if goes_round(r) else []
        for period_deg in [at["period"]] if "period" in at else [*r.known_periods_deg, *of_turn]:
            yield from waves_by_side(r, period_deg)
    moves_deg = np.abs(r.move_deg[~r.starts])
    if len(moves_deg) and np.ptp(moves_deg) > UNEQUAL * moves_deg.max():  # else it is as by direction
        yield _shape(tilted(standardised(r.move_deg)), LAST_MOVE.name, "linear")
    if r.temperature_c is not None and np.ptp(r.temperature_c) > 0.0:
        yield from _of_one(r.temperature_c, "temperature_c", tilted, at)
    for name, column in r.covariates.items():
        if is_circle(name) and covered(column) >= LEAST_ARC_DEG:
            yield replace(_shape(tilted(circle(column, 1)), name, CIRCLE), at={"period": 360.0})
            yield replace(_shape(tilted(circle(column, 2)), name, CIRCLE_2), at={"period": 360.0})
        yield _shape(tilted(standardised(column)), name, "linear")
        yield from _of_one(column, name, tilted, at)
        yield from _in_time(r, name, at)
        if ANGLE in r.channels:
            yield from _of_the_reading(column, name)
    for name, factors, columns in products(r):
        yield replace(_shape(tilted(columns), name, "product"), beside=factors)
    if r.time_s is not None and np.ptp(r.time_s) > 0.0:
        for count in KNOTS:
            yield _shape(tilted(natural_spline(r.time_s, count)), "time_s", f"smooth {count}")
        if not is_time_elevation(r):  # there a cycle of time is a period of the angle
            yield from _cycles(r, r.time_s)


def _of_elevation(r: Responses, at: Parameters) -> Iterator[Shape]:
    """Curves of the elevation, the same or not from both sides, and those that the stage itself makes."""
    yield from _of_one(r.theta_deg, "target_deg", tilted, at, has_knots=r.reference_is_good)
    places = _places(r.theta_deg)
    more = [count for count in MORE_KNOTS if len(r) >= POSES_A_KNOT * count and places > count + 1]
    for count in more:
        yield _smooth(r.theta_deg, count, "target_deg", tilted, has_knots=r.reference_is_good)
    if (each := _through_each_place(r.theta_deg)) is not None:
        shape = _of_function(each, r.theta_deg, "target_deg", AT_EACH_PLACE, tilted)
        says = f"as measured at {len(each.knots)} angles; between them it is drawn smoothly, and not measured"
        yield replace(shape, says=says, knots=tuple(each.at.tolist()) if r.reference_is_good else ())
    if r.approach is not None and np.ptp(r.approach) > 0.0:  # play that is not the same everywhere
        for count in (*KNOTS, *more):
            curve = natural_spline(r.theta_deg, count)
            by_side = ((curve - curve.mean(axis=0)).T * r.approach).T  # backlash beside it is the mean
            shape = _shape(tilted(by_side), f"{BY_SIDE}target_deg", f"smooth {count}, by side")
            yield replace(shape, beside=("approach",))
        if each is not None:  # as far apart at one place as at another, or not
            by_side = r.approach[:, None] * np.column_stack([np.ones(len(r)), each(r.theta_deg)])
            yield _shape(tilted(by_side), f"{BY_SIDE}target_deg", f"{AT_EACH_PLACE}, by side")
    yield from _unsteady(r)
    if (spacing := spacing_deg(r.theta_deg)) is not None:
        alternating = np.where(steps_of(r.theta_deg, spacing) % 2.0 == 0.0, 1.0, -1.0)
        yield _shape(turned(r, alternating), "target_deg", ALTERNATING, {"period": 2.0 * spacing})
    if MOVE in r.channels:  # without a gyro to feel it, a stage's shape is the same thing again
        of_stage = partial(turned, r)
        stage = _of_one(r.theta_deg, "target_deg", of_stage, at, has_knots=r.reference_is_good)
        yield from (replace(shape, form=f"{shape.form}{OF_THE_STAGE}") for shape in stage)


def waves_by_side(r: Responses, period_deg: float) -> Iterator[Shape]:
    """Yield what a periodic error differs by from one direction to the other, where both are there.

    The error of a motor under friction or of a worm with play is a wave of another phase each way: their mean
    is a wave of the angle, and half their difference one that changes sign with the approach.
    """
    if r.approach is not None and np.ptp(r.approach) > 0.0:
        waves = circle(TURN_DEG / period_deg * r.theta_deg, 1) * r.approach[:, None]
        shape = _shape(tilted(waves), f"{BY_SIDE}target_deg", WAVE_BY_SIDE, {"period": period_deg})
        yield replace(shape, scanned=False)


def _unsteady(r: Responses) -> Iterator[Shape]:
    """Return the elevation less the mean of its neighbours, in poses on the way: errors of the reference.

    Readings follow the sensor, not an angle that was misread. A move has that error too, so that readings
    seem to lag behind their last move, as if the sensor had not settled; but behind the next one as well.
    """
    if np.abs(r.move_deg).max() == 0.0:
        return
    inner = np.flatnonzero(~r.starts & ~np.append(r.starts[1:], True))
    before_deg, after_deg = (np.diff(r.theta_deg)[inner - k] for k in (1, 0))
    inner_off_deg = np.where(before_deg * after_deg > 0.0, (before_deg - after_deg) / 2.0, 0.0)
    off_deg = np.zeros(len(r))
    off_deg[inner] = inner_off_deg
    along_deg = off_deg[np.argsort(r.theta_deg, kind="stable")]
    is_of_place = along_deg[1:] @ along_deg[:-1] > ALIKE_NEARBY * (along_deg @ along_deg)
    if np.count_nonzero(off_deg) > len(r) / 2 and not is_of_place:
        yield _shape(turned(r, off_deg), "target_deg", UNSTEADY)


def _is_possible(shape: Shape, beta: FloatArray) -> bool:
    """Return whether readings follow no more than all that an elevation does, and no less than nothing."""
    return shape.form != UNSTEADY or -1.0 <= float(beta[0]) <= 0.0


def _shape(
    shares: Mapping[str, FloatArray], covariate: str, form: str, at: Parameters | None = None
) -> Shape:
    return Shape(
        shares,
        ("size_deg",),
        form=form,
        at=at or {},
        scanned=at is not None,
        covariate=covariate,
    )


def _smooth(z: FloatArray, pieces: int, name: str, seen_by: Shares, *, has_knots: bool = False) -> Shape:
    """Return a smooth curve; with its knots where a document is to have them."""
    curves = NaturalSplines.over(z, pieces)
    shape = _of_function(curves, z, name, f"smooth {pieces}", seen_by)
    return replace(shape, knots=tuple(curves.at.tolist())) if has_knots else shape


def _of_one(
    z: FloatArray, name: str, seen_by: Shares, at: Parameters, *, has_knots: bool = False
) -> Iterator[Shape]:
    few = few_places(z) if name == "target_deg" else None
    places = _places(z) if few is None else int(few.max()) + 1
    for count in _counts(places):
        yield _smooth(z, count, name, seen_by, has_knots=has_knots)
    if places < FEWEST_VALUES:
        return
    scanned = np.unique(np.quantile(z, PLACES)).tolist()
    if "at" in at and "period" not in at:  # a circle's is where it is largest
        scanned = [at["at"]]
    for place in scanned:
        here = {"at": place, "span": at.get("span", float(np.ptp(z)))}
        yield from (_at_place(z, name, form, seen_by, here) for form in (KINK, STEP))


def _at_place(z: FloatArray, name: str, form: str, seen_by: Shares, at: Parameters) -> Shape:
    place, is_kink = at["at"], form.startswith(KINK)
    f = partial(_kink, place=place, span=at["span"]) if is_kink else partial(_step, place=place)
    return _of_function(f, z, name, form, seen_by, at)


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape | None:
    """Return a kink where it is likeliest near the place scanned; a step in the middle of such a gap."""
    if not shape.form.startswith((KINK, STEP)):
        return None
    z = {ELEVATION.name: r.theta_deg, "temperature_c": r.temperature_c, **r.covariates}[shape.covariate]
    assert z is not None  # noqa: S101 (the shape is one of it)
    seen_by = partial(turned, r) if shape.form.endswith(OF_THE_STAGE) else tilted

    def at(place: float) -> Shape:  # of the span of all poses, in a fold too
        return _at_place(z, shape.covariate, shape.form, seen_by, {**shape.at, "at": float(place)})

    of_at = np.array([(z < shape.at["at"]).mean() - NEARBY, (z <= shape.at["at"]).mean() + NEARBY])
    low, high = np.quantile(z, np.clip(of_at, PLACES[0], PLACES[-1])).tolist()
    if low == high:  # nearly all poses have one value
        return None
    if shape.form.startswith(KINK):
        from scipy.optimize import minimize_scalar

        found = minimize_scalar(
            lambda place: criterion(at(place)),
            bounds=(low, high),
            method="bounded",
            options={"xatol": FINE * (high - low)},
        )
        return min(at(shape.at["at"]), at(found.x), key=criterion)
    values = np.unique(z)
    gaps = (values[1:] + values[:-1]) / 2.0
    gaps = gaps[np.searchsorted(values, low, "right") - 1 : np.searchsorted(values, high)]
    while len(gaps) > 1:
        tried = np.unique(np.linspace(0, len(gaps) - 1, GAPS).round().astype(int))
        best = int(np.argmin([criterion(at(gaps[k])) for k in tried]))
        ends = np.concatenate([[-1], tried, [len(gaps)]])
        gaps = gaps[ends[best] + 1 : ends[best + 2]]
    return at(gaps[0])


def _of_function(
    f: Callable[[FloatArray], FloatArray],
    z: FloatArray,
    name: str,
    form: str,
    seen_by: Shares = tilted,
    at: Parameters | None = None,
) -> Shape:
    shape = _shape(seen_by(f(z)), name, form, at)
    return replace(shape, at_elevation=f) if name == "target_deg" else shape


def _kink(z: FloatArray, place: float, span: float) -> FloatArray:
    return np.asarray(np.maximum(z - place, 0.0) / span, dtype=np.float64)


def _step(z: FloatArray, place: float) -> FloatArray:
    return np.asarray(z >= place, dtype=np.float64)


def _counts(places: int) -> list[int]:
    return [count for count in KNOTS if places > count + 1]


def _places(z: FloatArray) -> int:
    """Return how many values a column takes, those that differ by less than `ONE_PLACE` taken as one."""
    return len(np.unique(np.round((z - z.min()) / (ONE_PLACE * (np.ptp(z) or 1.0)))))


def _through_each_place(z: FloatArray) -> NaturalSplines | None:
    """Return the curves that may have any value at each of a few places, often visited; None at others."""
    places = few_places(z)
    if places is None:
        return None
    at = np.array([z[places == place].mean() for place in range(places.max() + 1)])
    return NaturalSplines(float(at[0]), float(np.ptp(at)), (at - at[0]) / np.ptp(at))


def few_places(z: FloatArray, visits: float = VISITS) -> Intp | None:
    """Return (n,) which of a few places each pose is at; None unless they are apart and visited so often.

    So are those of ISO 230-2 (2014, section 5.3.2): five or more, each visited five times from a side.
    """
    order = np.argsort(z)
    gaps = np.diff(z[order])
    near = ONE_OF_FEW * gaps.max(initial=0.0)
    groups = np.split(order, 1 + np.flatnonzero(gaps > near))
    if not FEWEST_PLACES <= len(groups) <= MOST_PLACES or len(z) < visits * len(groups):
        return None
    if max(np.ptp(z[group]) for group in groups) > near:
        return None
    places = np.empty(len(z), dtype=np.intp)
    places[order] = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    return places


def _of_the_reading(column: FloatArray, name: str) -> Iterator[Shape]:
    """Return what gravity does not see: the column reaches the filter, or what is added to its output."""
    alone = {"linear": standardised(column)}
    alone |= {f"smooth {count}": natural_spline(column, count) for count in _counts(_places(column))}
    for form, columns in alone.items():
        yield _shape({READING: columns}, name, f"{form}{OF_THE_READING}")


def _in_time(r: Responses, name: str, at: Parameters) -> Iterator[Shape]:
    """Return a column's rate, and the column behind a first-order lag."""
    change = rate(r, name)
    if change is not None and np.ptp(change) > 0.0:
        yield _shape(tilted(standardised(change)), name, "rate")
    for lag_s in [at["lag_s"]] if "lag_s" in at else delays_s(r):
        behind = delayed(r, name, float(lag_s))
        if behind is not None and np.ptp(behind) > 0.0:
            yield _shape(tilted(standardised(behind)), name, "delayed", {"lag_s": float(lag_s)})


def _cycles(r: Responses, time_s: FloatArray) -> Iterator[Shape]:
    span = float(np.ptp(time_s))
    most = min(0.45 * len(r), MOST_CYCLES)
    strokes = _of_strokes(r)
    for frequency in np.arange(1.0 / span, most / span, 1.0 / (3.0 * span)):
        waves = circle(360.0 * frequency * time_s, 1)
        if np.sum((strokes.T @ waves) ** 2) < ALIKE_STROKES * np.sum(waves**2):
            yield _shape(tilted(waves), "time_s", "cycle", {"period": float(1.0 / frequency)})


def _of_strokes(r: Responses) -> FloatArray:
    """Return orthonormal (n, p) curves of the elevation, and their differences by direction.

    What a stage that goes to and fro repeats in time is a cycle of its strokes, as hysteresis makes it.
    """
    if r.approach is None or np.ptp(r.approach) == 0.0 or not turns(r):
        return np.empty((len(r), 0))
    pieces = max(_counts(_places(r.theta_deg)), default=1)
    curve = np.column_stack([np.ones(len(r)), natural_spline(r.theta_deg, pieces)])
    return np.linalg.qr(np.column_stack([curve, curve * r.approach[:, None]]))[0]


def _reported(shape: Shape, beta: FloatArray, covariance: FloatArray) -> Documents:
    columns, sized = shape.shares[READING], shape
    if shape.covariate == ELEVATION.name and shape.form.startswith("smooth"):
        sized = replace(shape, shares={READING: bent_columns(columns)})  # a straight line is bias and scale
    if shape.covariate == ELEVATION.name and shape.form == KINK:  # off the line from end to end
        sized = replace(shape, shares={READING: columns * (1.0 - columns.max())})
    found: Documents = {"size_deg": size_deg(sized, beta, covariance), "period": None, "at": None}
    if shape.form == CIRCLE:
        found["at"] = amplitude_and_phase(shape, beta[::-1], covariance[::-1, ::-1])["phase_deg"]
    if len(shape.knots) >= FEWEST_KNOTS:
        found |= curve_document(np.array(shape.knots), columns, beta, covariance)
    return found


def _evidence(r: Responses, shape: Shape) -> list[str]:
    said = [f"shape: {shape.form}; no effect of the catalogue explains it as well"]
    column, unit = r.covariates.get(shape.covariate), unit_of_column(shape.covariate)
    if column is not None:
        of_unit = f" {unit}" if unit else ", of no unit that its name tells"
        said.append(f"{shape.covariate} went from {column.min():.5g} to {column.max():.5g}{of_unit}")
    if shape.form.endswith(OF_THE_READING):
        said.append("the reading moved and the accelerometer did not: look at what filters the reading")
    if shape.form == WAVE_BY_SIDE:
        period = f"{shape.at['period']:.5g}°"
        said.append(f"half of what the periodic error of {period} differs by from one direction to the other")
    if shape.form == UNSTEADY:
        said.append("readings follow the elevation less from pose to pose: it may have been read with errors")
    if shape.form == ALTERNATING:
        said.append(
            f"a period of {shape.at['period']:.4g}°, twice the spacing, or an odd part of it: size_deg is by "
            "how much the poses alternate; between them the wave may be larger, and its phase is not known"
        )
    return said


def fitted_words(r: Responses, shape: Shape, added_deg: FloatArray, stated: Documents) -> list[str]:
    """Return where a circle is largest, or the slope of a straight line, a sentence in a list; else none.

    `added_deg` (n,) is what the shape adds to the readings, `stated` its parameters in a document.
    """
    at, unit = stated.get("at"), unit_of_column(shape.covariate)
    if shape.form == CIRCLE and at is not None:
        return [f"maximum at {at['value']:.1f}{unit if unit == '°' else f' {unit}'.rstrip()}"]
    column, size = r.covariates.get(shape.covariate), stated.get("size_deg")
    if column is None or size is None or not shape.form.startswith("linear"):
        return []
    slope = math.copysign(1.0 / float(np.ptp(column)), float((column - column.mean()) @ added_deg))
    words = number_text(slope * (size["value"] or 0.0), abs(slope) * (size["std"] or 0.0), 3, "°")
    return [f"the reading changes by {words} per {unit or f'unit of {shape.covariate}'}"]


def _curve(parameters: Parameters) -> SplineCurve:
    curve = SplineCurve.of(parameters)
    if curve is None:
        raise ApplyError("the effect 'unnamed' has no formula of its own that could be applied")
    return curve


EFFECT = Effect(
    name="unnamed",
    title="Structure without a name",
    origin="unknown",
    scope="run",
    covariate=Covariate("any column", "any column", "", lambda _r: None),
    parameters=(
        Parameter("size_deg", "Size (peak to peak)", "°"),
        Parameter("period", "Period", None),
        Parameter("at", "At", None),
        Parameter("lag_s", "Delay", "s"),
    ),
    formula="a smooth curve, kink, step or cycle that no effect of the catalogue explains; of the angle, "
    "with a good reference, the natural cubic spline with the values curve_K_deg at θ = knot_K_deg",
    forms=_forms,
    refine=_refine,
    on_reading_deg=lambda p: _curve(p.parameters)(p.theta_deg),
    in_c=lambda parameters: _curve(parameters).in_c(),
    reported=_reported,
    possible=_is_possible,
    evidence=_evidence,
    apart="what the column stands for, once somebody has looked",
    remedy="look at what changes with this column",
    as_sensor=Wording(
        "Nonlinearity without a name", "where it is a smooth curve, correct it by the unit's calibration"
    ),
)
