"""A move that has not settled, in the filter alone or in the mount (creep) that the accelerometer sees.

A creeping mount goes on after the dwell: the gyro feels what is still missing at its end, a share of the
dwell's mean that depends on how fast it creeps, together with the next move. While the stage turns evenly it
falls behind by a share of what it turns in the creep's time constant, upward one way and downward the other:
almost a backlash, but that it builds up in the first stretches of each pass and is caught up in the dwell.
"""

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.channels import ANGLE, MOVE, READING
from calrig.calibration.regression.effect import (
    LAST_MOVE,
    Applied,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.motion import behind
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted
from calrig.estimation.angles import FloatArray

LEFT_AT_THE_END = (0.1, 0.5, 0.9)
"""Of what the dwell lacks in the mean, for time constants of 0.3, 0.8 and 5 dwells."""

LARGEST_FRACTION = 0.5
"""A mean that lacks half the move is of the move and not of a dwell."""


CREEPS_S = (0.3, 0.7, 1.5, 3.0, 6.0)
"""Time constants that are tried of what creeps behind a turn."""


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    if np.abs(r.move_deg).max() == 0.0:
        return
    if not r.settled.all():  # of a sweep a few dwells alone had to settle
        if r.time_s is not None and "lag_s" in at:
            lags = behind(r.time_s, r.theta_deg, r.stretch_deg, r.starts, at["lag_s"])
            shares = {**tilted(-lags.mean_deg, r.sense), MOVE: -lags.grown_deg}
            yield Shape(
                shares, ("fraction",), form="behind", at={"lag_s": at["lag_s"]}, scanned=True, place_cost=1
            )
        return
    yield Shape({READING: -r.sense * r.move_deg}, ("fraction",), form="filter")
    if ANGLE not in r.channels:
        return
    moves_before = np.roll(r.move_deg, 1)
    moves_before[r.starts] = 0.0
    for share in LEFT_AT_THE_END if MOVE in r.channels else (0.0,):
        # what is missing when the dwell begins goes with the move itself: the gain of the gyro's base has it
        shares = {**tilted(-r.move_deg, r.sense), MOVE: share * moves_before}
        yield Shape(shares, ("fraction",), form=f"creep, {share:g} left")


def _on_reading_deg(p: Applied) -> FloatArray:
    turned_deg, time_s = p.given.get("stretch_deg"), p.given.get("time_s")
    if "lag_s" not in p.parameters or turned_deg is None or time_s is None:
        return -p.value("fraction") * p.moved_deg()
    starts = np.arange(len(time_s)) == 0
    lags = behind(time_s, p.theta_deg, turned_deg, starts, p.value("lag_s"))
    return np.asarray(-p.value("fraction") * lags.mean_deg)


EFFECT = Effect(
    name="settling",
    title="Incomplete settling",
    origin="process",
    scope="run",
    covariate=LAST_MOVE,
    parameters=(
        Parameter("fraction", "Share of the move missing", ""),
        Parameter("lag_s", "Time constant of the creep, of a sweep", "s"),
    ),
    formula="−fraction·move; of a sweep −fraction·b, lag_s·db/dt = lag_s·velocity − b",
    forms=_forms,
    scan=lambda r: iter([{"lag_s": lag_s} for lag_s in CREEPS_S] if r.stretch_deg.any() else [{}]),
    on_reading_deg=_on_reading_deg,
    in_c=NotInFlight("it is of the procedure that measured, not of the unit"),
    apart="proportional to the last move; unequal steps in random order tell it from backlash",
    remedy="settle longer before the dwell",
    # a reading ahead of its move has not failed to settle
    possible=lambda _shape, beta: 0.0 <= float(beta[0]) <= LARGEST_FRACTION,
)
