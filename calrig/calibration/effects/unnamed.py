"""Structure that no catalogue entry explains, against any covariate: smooth, kink, step, cycle in time.

A column that nobody knew is tried as what its name says that it is: an angle is a circle; where times are
known its rate and its delay as well; the product of two columns once both are in the model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from calrig.calibration.channels import ANGLE, MOVE, READING
from calrig.calibration.column_forms import (
    LEAST_ARC_DEG,
    arc_deg,
    circle,
    delayed,
    delays_s,
    products,
    rate,
    standardised,
)
from calrig.calibration.column_units import TIMES, is_circle, unit_of_column
from calrig.calibration.effect import (
    Applied,
    ApplyError,
    Covariate,
    Documents,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.effect_terms import amplitude_and_phase, size_deg, tilted, turned, turns
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

KNOTS = (3, 5)
MORE_KNOTS, POSES_A_KNOT = (9, 17, 33), 12
"""Of the elevation, where there are so many poses to each: a potentiometer may be wavy all along."""
OF_THE_READING = ", of the reading alone"
CIRCLE, CIRCLE_2 = "circle, order 1", "circle, orders 1 and 2"
PLACES = np.linspace(0.06, 0.94, 23)
FEWEST_VALUES = 8
MOST_CYCLES = 60.0
"""A run is searched for cycles in time up to this many, or as many as its poses can show."""
Shares = Callable[[FloatArray], Mapping[str, FloatArray]]


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    """Every covariate's flexible shapes; whoever knows the place of one takes the nearest."""
    if turns(r):
        yield from _of_elevation(r)
    if r.temperature_c is not None and np.ptp(r.temperature_c) > 0.0:
        yield from _of_one(r.temperature_c, "temperature_c", tilted)
    for name, column in r.covariates.items():
        if is_circle(name) and arc_deg(column) >= LEAST_ARC_DEG:
            yield replace(_shape(tilted(circle(column, 1)), name, CIRCLE), at={"period": 360.0})
            yield replace(_shape(tilted(circle(column, 2)), name, CIRCLE_2), at={"period": 360.0})
        yield _shape(tilted(standardised(column)), name, "linear")
        yield from _of_one(column, name, tilted)
        yield from _in_time(r, name, at)
        if ANGLE in r.channels:
            yield from _of_the_reading(column, name)
    for name, factors, columns in products(r):
        yield replace(_shape(tilted(columns), name, "product"), beside=factors)
    if r.time_s is not None and np.ptp(r.time_s) > 0.0:
        for count in KNOTS:
            yield _shape(tilted(natural_spline(r.time_s, count)), "time_s", f"smooth {count}")
        yield from _cycles(r, r.time_s)


def _of_elevation(r: Responses) -> Iterator[Shape]:
    """Curves of the elevation, the same or not from both sides, and those that the stage itself makes."""
    yield from _of_one(r.theta_deg, "target_deg", tilted)
    for count in MORE_KNOTS:
        if len(r) >= POSES_A_KNOT * count and len(np.unique(r.theta_deg)) > count + 1:
            yield _shape(tilted(natural_spline(r.theta_deg, count)), "target_deg", f"smooth {count}")
    if r.approach is not None and np.ptp(r.approach) > 0.0:  # play that is not the same everywhere
        for count in KNOTS:
            by_side = (natural_spline(r.theta_deg, count).T * r.approach).T
            shape = _shape(tilted(by_side), f"approach{TIMES}target_deg", f"smooth {count}, by side")
            yield replace(shape, beside=("approach",))
    if MOVE in r.channels:  # without a gyro to feel it, a stage's shape is the same thing again
        stage = _of_one(r.theta_deg, "target_deg", lambda f: turned(r, f))
        yield from (replace(shape, form=f"{shape.form}, of the stage") for shape in stage)


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


def _of_one(z: FloatArray, name: str, seen_by: Shares) -> Iterator[Shape]:
    for count in _counts(z):
        yield _shape(seen_by(natural_spline(z, count)), name, f"smooth {count}")
    if len(np.unique(z)) < FEWEST_VALUES:
        return
    for place in np.unique(np.quantile(z, PLACES)):
        at = {"at": float(place)}
        yield _shape(seen_by(np.maximum(z - place, 0.0) / np.ptp(z)), name, "kink", at)
        yield _shape(seen_by((z >= place).astype(float)), name, "step", at)


def _counts(z: FloatArray) -> list[int]:
    values = len(np.unique(z))
    return [count for count in KNOTS if values > count + 1]


def _of_the_reading(column: FloatArray, name: str) -> Iterator[Shape]:
    """What gravity does not see: the column reaches the filter, or what is added to its output."""
    alone = {"linear": standardised(column)}
    alone |= {f"smooth {count}": natural_spline(column, count) for count in _counts(column)}
    for form, columns in alone.items():
        yield _shape({READING: columns}, name, f"{form}{OF_THE_READING}")


def _in_time(r: Responses, name: str, at: Parameters) -> Iterator[Shape]:
    """A column's rate, and the column behind a first-order lag."""
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
    for frequency in np.arange(1.0 / span, most / span, 1.0 / (3.0 * span)):
        phase = 2.0 * np.pi * frequency * time_s
        waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        yield _shape(tilted(waves), "time_s", "cycle", {"period": float(1.0 / frequency)})


def natural_spline(z: FloatArray, count: int) -> FloatArray:
    """(n, ≤ count) basis of the natural cubic splines with knots at quantiles, the constant left out.

    Hastie, Tibshirani & Friedman, The Elements of Statistical Learning, equations 5.4 and 5.5.
    """
    u = (z - z.min()) / np.ptp(z)
    knots = np.unique(np.quantile(u, np.linspace(0.0, 1.0, count + 1)))
    if len(knots) < 3:
        return np.asarray(u[:, None], dtype=np.float64)
    last = knots[-1]

    def bend(k: int) -> FloatArray:
        cubes = np.maximum(u - knots[k], 0.0) ** 3 - np.maximum(u - last, 0.0) ** 3
        return np.asarray(cubes / (last - knots[k]), dtype=np.float64)

    straightened = [bend(k) - bend(len(knots) - 2) for k in range(len(knots) - 2)]
    return np.asarray(np.column_stack([u, *straightened]), dtype=np.float64)


def _reported(shape: Shape, beta: FloatArray, covariance: FloatArray) -> Documents:
    found: Documents = {"size_deg": size_deg(shape, beta, covariance), "period": None, "at": None}
    if shape.form == CIRCLE:
        found["at"] = amplitude_and_phase(shape, beta[::-1], covariance[::-1, ::-1])["phase_deg"]
    return found


def _evidence(r: Responses, shape: Shape) -> list[str]:
    said = [f"shape: {shape.form}; no effect of the catalogue explains it as well"]
    column, unit = r.covariates.get(shape.covariate), unit_of_column(shape.covariate)
    if column is not None:
        of_unit = f" {unit}" if unit else ", of no unit that its name tells"
        said.append(f"{shape.covariate} went from {column.min():.5g} to {column.max():.5g}{of_unit}")
    if shape.form.endswith(OF_THE_READING):
        said.append("the reading moved and the accelerometer did not: look at what filters the reading")
    if shape.form == CIRCLE:
        said.append(
            f"`at` is where it is largest, in the {unit} of the column; size_deg is from there to the least"
        )
    return said


def _on_reading_deg(p: Applied) -> FloatArray:
    raise ApplyError(f"the effect {p.effect!r} has no formula of its own that could be applied")


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
    formula="a smooth curve, kink, step or cycle that no effect of the catalogue explains",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight("it has no formula of its own that a header could hold"),
    reported=_reported,
    evidence=_evidence,
    apart="what the column stands for, once somebody has looked",
    remedy="look at what changes with this column",
)
