"""A drift in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import TIME, Effect, NotInFlight, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if r.time_s is not None and np.ptp(r.time_s) > 0.0:
        yield Shape(tilted(r.time_s - r.time_s.min()), ("deg_per_s",))


EFFECT = Effect(
    name="time_drift",
    title="Drift in time",
    origin="environment",
    scope="run",
    covariate=TIME,
    parameters=(Parameter("deg_per_s", "Rate", "°/s"),),
    formula="deg_per_s·t",
    forms=_forms,
    on_reading_deg=lambda p: p.value("deg_per_s") * p.column("time_s"),
    in_c=NotInFlight("it says nothing of a time after its run"),
    apart="goes on when the temperature does not, and does not come back with it",
    remedy="measure a reference elevation between sweeps and take the drift out",
)
