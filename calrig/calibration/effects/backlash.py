"""Backlash between motor and table.

After a turn the table stands until the motor has come by the whole play. A rig that takes the play up before
each pose, by going beyond and back, shows all of it after the shortest move. A coupling under friction yields
before it slips: what is left of the old side dies away with the way since the turn (Dahl, Solid friction
damping of mechanical vibrations, AIAA Journal 14, 1976, equation 5 with exponent 1).
"""

from collections.abc import Callable, Iterator, Mapping
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
YIELDING, YIELDS, LONGEST = "yielding", 6, 1.0 / 3.0
"""How many ways are tried over which a coupling yields: from half the mean distance of elevations to that
share of the range."""
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
            yield from (_yielding(r, way_deg, at.get("begins", 0.0)) for way_deg in _yields_deg(r, at))
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


def _yields_deg(r: Responses, at: Parameters) -> list[float]:
    if "yield_deg" in at:
        return [float(at["yield_deg"])]
    arc_deg = float(np.ptp(r.theta_deg))
    shortest_deg, longest_deg = arc_deg / (2 * len(np.unique(r.theta_deg))), LONGEST * arc_deg
    return np.geomspace(shortest_deg, longest_deg, YIELDS).tolist() if shortest_deg < longest_deg else []


def _yielding(r: Responses, yield_deg: float, begins: float = 0.0) -> Shape:
    """Return the shape of a coupling that yields, which a run `begins` on one side, −1 or +1, or between."""
    assert r.approach is not None  # noqa: S101 (the caller looked)
    theta_deg, approach = r.theta_deg, r.approach
    state = np.where(r.starts, begins, 0.0)
    for k in np.flatnonzero(~r.starts):
        way_deg, left, before = abs(theta_deg[k] - theta_deg[k - 1]), state[k - 1], approach[k - 1]
        if approach[k] * before < 0.0 and np.isfinite(r.travel_deg[k]):  # it turned between, perhaps beyond
            way_deg = r.travel_deg[k]
            beyond_deg = before * (theta_deg[k] - approach[k] * way_deg - theta_deg[k - 1])
            left = before + (left - before) * np.exp(-max(beyond_deg, 0.0) / yield_deg)
        state[k] = approach[k] + (left - approach[k]) * np.exp(-way_deg / yield_deg)
    return Shape(
        turned(r, state / 2.0),
        ("backlash_deg",),
        form=YIELDING,
        at={"yield_deg": yield_deg, "begins": begins},
        scanned=True,
        place_cost=1,
        is_linear=True,
    )


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape | None:
    """Return the shape at the likeliest way over which a coupling yields, near the one tried."""
    if shape.form != YIELDING:
        return None
    from scipy.optimize import minimize_scalar

    tried_deg = _yields_deg(r, {})
    ratio, middle_deg = tried_deg[1] / tried_deg[0] if tried_deg else 2.0, shape.at["yield_deg"]
    begun = (_yielding(r, middle_deg, begins) for begins in (0.0, -1.0, 1.0))
    best = min(begun, key=criterion)
    found = minimize_scalar(
        lambda power: criterion(_yielding(r, middle_deg * ratio**power, best.at["begins"])),
        bounds=(-1.0, 1.0),
        method="bounded",
        options={"xatol": 0.01},
    )
    return min(best, _yielding(r, middle_deg * ratio**found.x, best.at["begins"]), key=criterion)


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
    if travel_deg is not None and "yield_deg" in p.parameters:  # of the other side, where it turned
        return np.asarray(whole * (1.0 - 2.0 * np.exp(-travel_deg / p.value("yield_deg"))))
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
        Parameter("yield_deg", "Way over which it yields after a turn", "°"),
        Parameter("taken_up", "Taken up before each pose, however short the move (1)", ""),
    ),
    formula="(backlash_deg + growth_deg_per_deg·(θ − middle_deg))/2·approach: half the hysteresis, sign by "
    "direction; with yield_deg times 1 − 2·exp(−travel/yield_deg), travel since the stage turned",
    forms=_forms,
    refine=_refine,
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
