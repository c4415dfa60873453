"""A mount that goes on giving way after it was fastened: by as much in each tenfold of the time.

Glue, plastic and bolted joints relax with many time constants, of about equal share in each decade: together
they creep with the logarithm of time (Findley, Lai & Onaran, Creep and Relaxation of Nonlinear Viscoelastic
Materials, 1976, chapter 5).
"""

from collections.abc import Callable, Iterator

import numpy as np

from calrig.calibration.regression.effect import (
    TIME,
    Effect,
    NotInFlight,
    Parameter,
    Parameters,
    Shape,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import tilted
from calrig.estimation.angles import FloatArray

LEAST_S = 1.0
"""The first second is not looked into: a logarithm begins nowhere."""
BEFORE = (0.0, 0.03, 0.1, 0.3)
"""Of the run's span: how long before it the mount may have been fastened. Longer ago it is a drift."""
REFINEMENTS = 8


def _scan(r: Responses) -> Iterator[Parameters]:
    if r.time_s is not None:
        yield from ({"began_s": 0.0 - share * float(np.ptp(r.time_s))} for share in BEFORE)


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    if r.time_s is None or np.ptp(r.time_s) == 0.0 or r.time_s.min() < 0.0:
        return
    began_s = at.get("began_s", 0.0)
    shares = tilted(_decades(r.time_s, began_s))
    # when it was fastened nobody says: with the run is one answer of many, and costs what a place does
    form = "with the run" if began_s == 0.0 else "before it"
    yield Shape(shares, ("deg_per_decade",), form=form, at={"began_s": began_s}, scanned=True, place_cost=1)


def _decades(time_s: FloatArray, began_s: float) -> FloatArray:
    return np.asarray(np.log10(np.maximum(time_s - began_s, LEAST_S)), dtype=np.float64)


def _refine(r: Responses, shape: Shape, criterion: Callable[[Shape], float]) -> Shape | None:
    """Return the best beginning about the one scanned."""
    if shape.at["began_s"] == 0.0:
        return None
    tried = (float(factor) * shape.at["began_s"] for factor in np.geomspace(0.4, 2.5, REFINEMENTS + 1))
    return min((one for at in tried for one in _forms(r, {"began_s": at})), key=criterion, default=None)


EFFECT = Effect(
    name="mount_creep",
    title="Creep of the mount",
    origin="mounting",
    scope="run",
    covariate=TIME,
    parameters=(
        Parameter("deg_per_decade", "In each tenfold of the time", "°"),
        Parameter("began_s", "Fastened at, on the run's clock", "s"),
    ),
    formula="deg_per_decade·log₁₀(t − began_s), t in seconds, 1 s at least",
    forms=_forms,
    scan=_scan,
    refine=_refine,
    on_reading_deg=lambda p: p.value("deg_per_decade") * _decades(p.column("time_s"), p.value("began_s")),
    in_c=NotInFlight("the mount is fastened anew for flight"),
    apart="fast at first and ever slower, whatever the temperature does: measure again without touching it",
    remedy="wait between fastening and measuring, ten times as long as a run takes; or clamp it stiffer",
)
