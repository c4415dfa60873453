"""Backlash between motor and table.

After a turn the table stands until the motor has come by the whole play. A rig that takes the play up before
each pose, by going beyond and back, shows all of it after the shortest move.
"""

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
    Wording,
)
from calrig.calibration.regression.motion import slack_deg
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import turned, turns
from calrig.estimation.angles import FloatArray

LARGEST_DEG = 30.0
"""A tooth of a gear of twelve: beyond it the teeth do not meet any more."""
GROWING = "growing"
OPPOSED = 0.25
"""Of the largest hysteresis, what may be of the other sign at the end with the least: noise, but no play."""
TURNED_DEG = 1e-9
"""Of way before a move: none, but for rounding; the stage turned there."""


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    if r.approach is not None and {-1.0, 1.0} <= set(r.approach):
        at_one_speed = r.motion is not None and r.motion.has_one_speed
        alike = ("latency",) if at_one_speed else ()
        shape = Shape(turned(r, r.approach / 2.0), ("backlash_deg",), alike=alike)
        yield shape
        if np.isfinite(r.travel_deg).any():
            yield replace(shape, form="taken up", at={"taken_up": 1.0}, place_cost=1, is_linear=True)
        if turns(r):
            middle_deg = float(at.get("middle_deg", (r.theta_deg.min() + r.theta_deg.max()) / 2.0))
            along = np.stack([np.ones(len(r)), r.theta_deg - middle_deg])
            yield replace(
                shape,
                shares=turned(r, (r.approach / 2.0 * along).T),
                parameters=("backlash_deg", "growth_deg_per_deg"),
                form=GROWING,
                at={"middle_deg": middle_deg},
                place_cost=1,
                is_linear=True,
            )


def _possible(shape: Shape, beta: FloatArray) -> bool:
    """Whether teeth can have such a play, of one sign along the range."""
    halves = np.reshape(shape.shares[READING], (-1, len(shape.parameters)))
    sides = np.sign(halves[:, 0])
    hysteresis_deg = 2.0 * sides[sides != 0.0] * (halves @ beta[: halves.shape[1]])[sides != 0.0]
    largest_deg = float(hysteresis_deg[np.argmax(np.abs(hysteresis_deg))])
    return abs(largest_deg) <= LARGEST_DEG and bool(
        (hysteresis_deg * np.sign(largest_deg)).min() >= -OPPOSED * abs(largest_deg)
    )


def _in_play(r: Responses, beta: FloatArray) -> Mapping[str, FloatArray]:
    """What is missing where the table stands in its play, after a turn that was followed by a short way."""
    play_deg, sense = float(beta[0]), -np.sign(beta[0]) * (0.0 if r.approach is None else r.approach)
    before_deg = r.travel_deg - np.abs(r.move_deg)
    slack = slack_deg(play_deg, r.travel_deg)
    slack_before = np.where(before_deg > TURNED_DEG, slack_deg(play_deg, before_deg), 0.0)
    return {READING: sense * slack, ANGLE: sense * slack, MOVE: sense * (slack - slack_before)}


def _on_reading_deg(p: Applied) -> FloatArray:
    play_deg, approach = p.value("backlash_deg"), p.column("approach")
    grown_deg = p.value("growth_deg_per_deg") * (p.theta_deg - p.value("middle_deg"))
    whole = (play_deg + grown_deg) / 2.0 * approach
    travel_deg = p.given.get("travel_deg")
    if travel_deg is None or p.value("taken_up") == 1.0 or "growth_deg_per_deg" in p.parameters:
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
        Parameter("growth_deg_per_deg", "Growth of the hysteresis along the range", "°/°"),
        Parameter("middle_deg", "Middle of the range", "°"),
        Parameter("taken_up", "Taken up before each pose, however short the move (1)", ""),
    ),
    formula="(backlash_deg + growth_deg_per_deg·(θ − middle_deg))/2·approach: half the hysteresis, sign by "
    "direction",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    not_linear=_in_play,
    in_c=NotInFlight("it belongs to the rig's stage"),
    apart="random order tells it from settling, reversals smaller than it from hysteresis of the mount",
    remedy="approach every elevation from the same side, or preload the gear with a spring",
    possible=_possible,
    as_sensor=Wording(
        "Hysteresis of sensor or coupling",
        "approach every elevation from the same side, or take up the play of coupling, gear and mount",
        "sensor or coupling",
    ),
)
