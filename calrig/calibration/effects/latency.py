"""Readings taken on the move that come late: those of the filter alone, or the accelerometer's with them.

The velocity is the column `velocity_dps`, or what times and elevations tell where the poses did not stand
(`regression.motion`). A reading that comes τ late is that of the elevation τ before it, and all of it:
bias, scale and every error that follows the elevation. It differs from the elevation by τ times the mean
velocity over the time τ before it: next to a reversal that is not the velocity at the reading.

At one constant speed forward and back, a delay is a backlash, but for the few readings next to a reversal,
where no real stage turns at once. An order of the turn parts them, if it is strong enough to see it shifted.
"""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.channels import ANGLE, READING
from calrig.calibration.regression.effect import (
    Applied,
    Covariate,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted
from calrig.estimation.angles import FloatArray

AS_SCANNED = np.geomspace(0.4, 2.5, 9)
"""Of the delay that a straight line through the errors against the velocity tells."""
WILD, LEAST_KEPT = 8.0, 0.5
"""Times the median error: farther rows tell no delay to begin with, unless these are the moves; of the
velocity's spread, what the others have to keep.
"""
LEAST_CHANGE = 1e-3
"""Of the velocity, as a share of the largest: at one velocity a delay is a bias."""
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


def _scan(r: Responses) -> Iterator[Parameters]:
    if r.motion is None or not r.motion.has_paths:
        yield {}
        return
    beside = np.column_stack([np.ones(len(r)), r.theta_deg, r.motion.velocity_dps])
    line = np.linalg.lstsq(beside, r.values[:, 0], rcond=None)[0]
    away_deg = np.abs(r.values[:, 0] - beside @ line)
    near = away_deg <= WILD * np.median(away_deg)  # outliers are left out of the search later, and not here
    if beside[near, 2].std() < LEAST_KEPT * beside[:, 2].std():
        near[:] = True
    delay_s = -r.sense * float(np.linalg.lstsq(beside[near], r.values[near, 0], rcond=None)[0][2])
    for factor in AS_SCANNED:
        yield {"over_s": float(delay_s * factor)}


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    velocity = _velocity_dps(r)
    if velocity is None or np.ptp(velocity) <= LEAST_CHANGE * np.abs(velocity).max():
        return
    here: Parameters = {}
    alike = ("backlash",) if r.motion is not None and r.motion.has_one_speed else ()
    if r.motion is not None and r.motion.has_paths:
        lag_s = at.get("over_s", at.get("delay_s", 0.0))
        velocity, here = r.motion.mean_dps(lag_s), {"over_s": lag_s}
    late = tilted(-velocity, r.sense)
    yield Shape(late, ("delay_s",), form="all", at=here, alike=alike, claimed_first=True)
    if ANGLE in r.channels:
        of_filter = {READING: late[READING]}
        yield Shape(of_filter, ("delay_s",), form="filter", at=here, alike=alike, claimed_first=True)


def _late_by_deg(r: Responses, delay_s: float) -> FloatArray:
    if r.motion is not None:
        return r.motion.travelled_deg(delay_s)
    return np.asarray(delay_s * r.covariates["velocity_dps"], dtype=np.float64)


def _possible(shape: Shape, beta: FloatArray) -> bool:
    lag_s = shape.at.get("over_s")
    if abs(float(beta[0])) > LARGEST_DELAY_S:
        return False
    return not lag_s or abs(float(beta[0])) <= CONSISTENT * abs(lag_s)


def _on_reading_deg(p: Applied) -> FloatArray:
    if p.given.motion is not None:
        return -p.given.motion.travelled_deg(p.value("delay_s"))
    return -p.value("delay_s") * p.column("velocity_dps")


EFFECT = Effect(
    name="latency",
    title="Time offset of readings",
    origin="process",
    scope="run",
    covariate=VELOCITY,
    parameters=(Parameter("delay_s", "Delay (negative: early)", "s"),),
    formula="−delay_s·velocity",
    forms=_forms,
    scan=_scan,
    possible=_possible,
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight("it is of the procedure that measured, not of the unit"),
    apart="proportional to the velocity at the time of the reading",
    remedy="read at rest, or subtract the delay from the readings' times; if it is negative, the readings "
    "are stamped early or the elevations late",
    late_by_deg=_late_by_deg,
)
