"""Readings taken on the move that come late: those of the filter alone, or the accelerometer's with them.

The velocity is the column `velocity_dps`, or what times and elevations tell where the poses did not stand
(`regression.motion`). A reading that comes τ late differs from the elevation by τ times the mean
velocity over the time τ before it: next to a reversal that is not the velocity at the reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from calrig.calibration.regression.channels import ANGLE, READING
from calrig.calibration.regression.effect import Covariate, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted
from calrig.estimation.angles import FloatArray

AS_SCANNED = np.geomspace(0.4, 2.5, 9)
FINER = (np.linspace(0.8, 1.25, 19), np.linspace(0.98, 1.02, 9))
"""Of the delay that a straight line through the errors against the velocity tells; of the one that leads."""
CONSISTENT = 3.0
"""Times the delay over which the velocity was averaged, a fitted one is another: two terms that cancel.
Smaller ones and those of the other sign are allowed, as noise has them: the significance test counts on it.
"""

LARGEST_DELAY_S = 10.0
"""Beyond it readings are of another pose."""


def _velocity_dps(r: Responses) -> FloatArray | None:
    if r.motion is not None:
        return r.motion.velocity_dps
    return r.covariates.get("velocity_dps")


VELOCITY = Covariate("velocity", "velocity", "°/s", _velocity_dps)


def _turns_abruptly(r: Responses) -> bool:
    return r.motion is not None and bool(np.isfinite([r.motion.since_s, r.motion.until_s]).any())


def _scan(r: Responses) -> Iterator[Parameters]:
    if r.motion is None or not _turns_abruptly(r):
        yield {}
        return
    beside = np.column_stack([np.ones(len(r)), r.theta_deg, r.motion.velocity_dps])
    delay_s = -float(np.linalg.lstsq(beside, r.values[:, 0], rcond=None)[0][2])
    for factor in AS_SCANNED:
        yield {"over_s": float(delay_s * factor)}


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    velocity = _velocity_dps(r)
    if velocity is None or np.ptp(velocity) == 0.0:
        return
    here: Parameters = {}
    if r.motion is not None and _turns_abruptly(r):
        lag_s = at.get("over_s", at.get("delay_s", 0.0))
        velocity, here = r.motion.mean_dps(lag_s), {"over_s": lag_s}
    yield Shape(tilted(-velocity), ("delay_s",), form="all", at=here)
    if ANGLE in r.channels:
        yield Shape({READING: -velocity}, ("delay_s",), form="filter", at=here)


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape | None:
    if not shape.at:
        return None
    for factors in FINER:
        lags_s = shape.at["over_s"] * factors
        # its own place is among these: a shape of all poses has more rows than a fold
        shapes = [s for lag_s in lags_s for s in _forms(r, {"over_s": float(lag_s)}) if s.form == shape.form]
        if not shapes:
            return None
        shape = min(shapes, key=criterion)
    return shape


def _possible(shape: Shape, beta: FloatArray) -> bool:
    lag_s = shape.at.get("over_s")
    if abs(float(beta[0])) > LARGEST_DELAY_S:
        return False
    return not lag_s or abs(float(beta[0])) <= CONSISTENT * abs(lag_s)


EFFECT = Effect(
    name="latency",
    title="Readings that come late",
    origin="process",
    scope="run",
    covariate=VELOCITY,
    parameters=(Parameter("delay_s", "Delay", "s"),),
    formula="−delay_s·velocity",
    forms=_forms,
    scan=_scan,
    refine=_refine,
    possible=_possible,
    on_reading_deg=lambda p: -p.value("delay_s") * p.column("velocity_dps"),
    in_c=NotInFlight("it is of the procedure that measured, not of the unit"),
    apart="proportional to the velocity at the time of the reading",
    remedy="read standing still, or advance the readings by the delay",
)
