"""Backlash between motor and table."""

from __future__ import annotations

from collections.abc import Iterator

from calrig.calibration.effect import APPROACH, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import turned, within
from calrig.calibration.responses import Responses

LARGEST_DEG = 30.0
"""A tooth of a gear of twelve: beyond it the teeth do not meet any more."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if r.approach is not None and {-1.0, 1.0} <= set(r.approach):
        yield Shape(turned(r, r.approach / 2.0), ("backlash_deg",))


EFFECT = Effect(
    name="backlash",
    title="Backlash of the stage",
    origin="stage",
    scope="rig",
    covariate=APPROACH,
    parameters=(Parameter("backlash_deg", "Hysteresis (up − down)", "°"),),
    formula="backlash_deg/2·approach",
    forms=_forms,
    on_reading_deg=lambda p: p.value("backlash_deg") / 2.0 * p.column("approach"),
    in_c=NotInFlight("it belongs to the rig's stage"),
    apart="random order tells it from settling, reversals smaller than it from hysteresis of the mount",
    remedy="approach every elevation from the same side, or preload the gear with a spring",
    possible=within(backlash_deg=LARGEST_DEG),
)
