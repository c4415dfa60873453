"""A drift in time: straight, or slowly curved.

In one sweep at an even pace time and elevation are one thing. A straight drift is an error of scale there,
and any curve of the elevation may be a drift: then it is called one, with what else it may be.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calrig.calibration.effects.unnamed import POSES_A_KNOT
from calrig.calibration.regression.channels import ANGLE
from calrig.calibration.regression.effect import (
    TIME,
    Applied,
    ApplyError,
    Documents,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
    linear,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.spline import natural_spline
from calrig.calibration.regression.terms import is_time_elevation, less_line, size_deg, tilted
from calrig.estimation.angles import FloatArray

FEWEST_TIMES = 8
"""Different ones that a curve needs."""
CURVES = (5, 9)
"""Knots of a drift that is a curve of the elevation as well."""
CURVED = ("deg_per_s2", "deg_per_s3")


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    if r.time_s is None or np.ptp(r.time_s) == 0.0:
        return
    straight = r.time_s - r.time_s.min()
    yield Shape(tilted(straight), ("deg_per_s",))
    if len(np.unique(r.time_s)) < FEWEST_TIMES:
        return
    middle_s = float(at.get("middle_s", r.time_s.mean()))
    curved = np.stack([(r.time_s - middle_s) ** power for power in (2, 3)], 1)
    if is_time_elevation(r):
        alike, at_middle = ("nonlinearity", "stage_eccentricity"), {"middle_s": middle_s}
        first = ANGLE not in r.channels
        shape = Shape(tilted(curved), CURVED, form="curved", at=at_middle, alike=alike, claimed_first=first)
        yield shape
        yield replace(
            shape, shares=tilted(curved[:, 0]), parameters=CURVED[:1], form="square", part_of="curved"
        )
        for count in CURVES:
            if len(r) >= POSES_A_KNOT * count:
                curve = less_line(r, natural_spline(r.time_s, count)[:, 1:])
                yield Shape(
                    tilted(curve), ("size_deg",), form=f"smooth {count}", alike=alike, claimed_first=first
                )
    else:
        every = np.column_stack([straight, curved])
        yield Shape(tilted(every), ("deg_per_s", *CURVED), form="curved", at={"middle_s": middle_s})


def _on_reading_deg(p: Applied) -> FloatArray:
    if "size_deg" in p.parameters:
        raise ApplyError("a drift without coefficients has no formula of its own that could be applied")
    time_s = p.column("time_s")
    since_s = time_s - p.value("middle_s")
    return np.asarray(
        p.value("deg_per_s") * time_s + p.value(CURVED[0]) * since_s**2 + p.value(CURVED[1]) * since_s**3
    )


def _reported(shape: Shape, beta: FloatArray, covariance: FloatArray) -> Documents:
    unknown: Documents = {} if "deg_per_s" in shape.parameters else {"deg_per_s": None}
    if shape.parameters == ("size_deg",):
        return {**unknown, "size_deg": size_deg(shape, beta, covariance)}
    return {**unknown, **linear(shape, beta, covariance)}


EFFECT = Effect(
    name="time_drift",
    title="Drift in time",
    origin="environment",
    scope="run",
    covariate=TIME,
    parameters=(
        Parameter("deg_per_s", "Rate", "°/s"),
        Parameter("deg_per_s2", "Quadratic coefficient", "°/s²"),
        Parameter("deg_per_s3", "Cubic coefficient", "°/s³"),
        Parameter("middle_s", "Middle of the run", "s"),
        Parameter("size_deg", "Size (peak to peak)", "°"),
    ),
    formula="deg_per_s·t + deg_per_s2·(t − middle_s)² + deg_per_s3·(t − middle_s)³",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    reported=_reported,
    in_c=NotInFlight("it says nothing of a time after its run"),
    apart="goes on when the temperature does not, and does not come back with it",
    remedy="measure a reference elevation between sweeps and take the drift out",
)
