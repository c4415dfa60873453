"""Backlash between motor and table.

After a turn the table stands until the motor has come by the whole play. A rig that takes the play up before
each pose, by going beyond and back, shows all of it after the shortest move.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from calrig.calibration.regression.channels import ANGLE, MOVE, READING
from calrig.calibration.regression.effect import (
    APPROACH,
    Applied,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.motion import slack_deg
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import turned, within
from calrig.estimation.angles import FloatArray

LARGEST_DEG = 30.0
"""A tooth of a gear of twelve: beyond it the teeth do not meet any more."""
TURNED_DEG = 1e-9
"""Of way before a move: none, but for rounding; the stage turned there."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if r.approach is not None and {-1.0, 1.0} <= set(r.approach):
        at_one_speed = r.motion is not None and r.motion.has_one_speed
        alike = ("latency",) if at_one_speed else ()
        shape = Shape(turned(r, r.approach / 2.0), ("backlash_deg",), alike=alike)
        yield shape
        if np.isfinite(r.travel_deg).any():
            yield replace(shape, form="taken up", at={"taken_up": 1.0}, place_cost=1, is_linear=True)


def _in_play(r: Responses, beta: FloatArray) -> Mapping[str, FloatArray]:
    """What is missing where the table stands in its play, after a turn that was followed by a short way."""
    play_deg, sense = float(beta[0]), -np.sign(beta[0]) * (0.0 if r.approach is None else r.approach)
    before_deg = r.travel_deg - np.abs(r.move_deg)
    slack = slack_deg(play_deg, r.travel_deg)
    slack_before = np.where(before_deg > TURNED_DEG, slack_deg(play_deg, before_deg), 0.0)
    return {READING: sense * slack, ANGLE: sense * slack, MOVE: sense * (slack - slack_before)}


def _on_reading_deg(p: Applied) -> FloatArray:
    play_deg, approach = p.value("backlash_deg"), p.column("approach")
    whole = play_deg / 2.0 * approach
    travel_deg = p.given.get("travel_deg")
    if travel_deg is None or p.value("taken_up") == 1.0:
        return np.asarray(whole)
    return np.asarray(whole - np.sign(play_deg) * approach * slack_deg(play_deg, travel_deg))


EFFECT = Effect(
    name="backlash",
    title="Backlash of the stage",
    origin="stage",
    scope="rig",
    covariate=APPROACH,
    parameters=(
        Parameter("backlash_deg", "Hysteresis (up − down)", "°"),
        Parameter("taken_up", "Taken up before each pose, however short the move (1)", ""),
    ),
    formula="backlash_deg/2·approach: half the hysteresis, sign by direction",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    not_linear=_in_play,
    in_c=NotInFlight("it belongs to the rig's stage"),
    apart="random order tells it from settling, reversals smaller than it from hysteresis of the mount",
    remedy="approach every elevation from the same side, or preload the gear with a spring",
    possible=within(backlash_deg=LARGEST_DEG),
)
