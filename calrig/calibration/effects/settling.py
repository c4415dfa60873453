"""A move that has not settled, in the filter alone or in the mount (creep) that the accelerometer sees.

A creeping mount goes on after the dwell: the gyro feels what is still missing at its end, a share of the
dwell's mean that depends on how fast it creeps, together with the next move.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.channels import ANGLE, MOVE, READING
from calrig.calibration.effect import LAST_MOVE, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import tilted, within
from calrig.calibration.responses import Responses

LEFT_AT_THE_END = (0.1, 0.5, 0.9)
"""Of what the dwell lacks in the mean, for time constants of 0.3, 0.8 and 5 dwells."""

LARGEST_FRACTION = 0.5
"""A mean that lacks half the move, or overshoots by as much, is of the move and not of a dwell."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if np.abs(r.move_deg).max() == 0.0 or not r.settled.all():  # of a sweep a few dwells alone had to settle
        return
    yield Shape({READING: -r.move_deg}, ("fraction",), form="filter")
    if ANGLE not in r.channels:
        return
    moves_before = np.roll(r.move_deg, 1)
    moves_before[r.starts] = 0.0
    for share in LEFT_AT_THE_END if MOVE in r.channels else (0.0,):
        # what is missing when the dwell begins goes with the move itself: the gain of the gyro's base has it
        shares = {**tilted(-r.move_deg), MOVE: share * moves_before}
        yield Shape(shares, ("fraction",), form=f"creep, {share:g} left")


EFFECT = Effect(
    name="settling",
    title="Incomplete settling",
    origin="process",
    scope="run",
    covariate=LAST_MOVE,
    parameters=(Parameter("fraction", "Share of the move missing", ""),),
    formula="−fraction·move",
    forms=_forms,
    on_reading_deg=lambda p: -p.value("fraction") * p.moved_deg(),
    in_c=NotInFlight("it is of the procedure that measured, not of the unit"),
    apart="proportional to the last move; unequal steps in random order tell it from backlash",
    remedy="settle longer before the dwell",
    possible=within(fraction=LARGEST_FRACTION),
)
