"""Readings taken on the move (a column velocity_dps) that come late."""

from __future__ import annotations

from collections.abc import Iterator

from calrig.calibration.effect import Covariate, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import tilted, within
from calrig.calibration.responses import Responses

VELOCITY = Covariate("velocity", "velocity", "°/s", lambda r: r.covariates.get("velocity_dps"))

LARGEST_DELAY_S = 10.0
"""Beyond it readings are of another pose."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    velocity = VELOCITY.of(r)
    if velocity is not None:
        yield Shape(tilted(-velocity), ("delay_s",))


EFFECT = Effect(
    name="latency",
    title="Readings that come late",
    origin="process",
    scope="run",
    covariate=VELOCITY,
    parameters=(Parameter("delay_s", "Delay", "s"),),
    formula="−delay_s·velocity",
    forms=_forms,
    on_reading_deg=lambda p: -p.value("delay_s") * p.column("velocity_dps"),
    in_c=NotInFlight("it is of the procedure that measured, not of the unit"),
    apart="proportional to the velocity at the time of the reading",
    remedy="read standing still, or advance the readings by the delay",
    possible=within(delay_s=LARGEST_DELAY_S),
)
