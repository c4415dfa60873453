"""Terms of a series, such as the orders of a turn or changes from run to run: which of them a model needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.ranking import MARGIN, Found
from calrig.calibration.responses import Responses
from calrig.calibration.run_changes import RUN
from calrig.calibration.sensor_model import fitted_model


def needed(r: Responses, accepted: Sequence[Candidate], terms: Sequence[Candidate]) -> list[Candidate]:
    """Those of some terms that pay for themselves beside the others."""
    kept = list(terms)
    while len(kept) > 1:
        whole = _criterion(r, [*accepted, *kept])
        without = [_criterion(r, [*accepted, *kept[:k], *kept[k + 1 :]]) - whole for k in range(len(kept))]
        least = int(np.argmin(without))
        if without[least] >= MARGIN:
            break
        del kept[least]
    return kept


def needed_changes(r: Responses, accepted: Sequence[Candidate], together: Candidate) -> list[Candidate]:
    """The members of a candidate, of several changes between runs those that are worth a parameter each."""
    members = list(together.members)
    bic_penalty = float(np.log(len(r)))

    def criterion(kept: Sequence[Candidate]) -> float:
        return fitted_model(r, [*accepted, *kept]).fitted.criterion + bic_penalty * len(kept)

    while len(members) > 1 and together.effect.covariate is RUN:
        fewer = min(([m for m in members if m is not one] for one in members), key=criterion)
        if criterion(fewer) > criterion(members):
            break
        members = fewer
    return members


def on_their_places(r: Responses, candidates: Sequence[Candidate], found: list[Found]) -> list[Found]:
    """Effects at scanned places put on the known ones beside them, where the model is the better for it.

    Found one after the other, each was refined while others were missing: all are tried at once, then each.
    """
    known = [c for c in candidates if c.shape.series and not c.shape.scanned and c.beside is None]
    moves = {k: place for k, f in enumerate(found) if (place := _beside(r, f.candidate, known)) is not None}
    for some in (list(moves), *([k] for k in moves)) if moves else ():
        put = [
            replace(f, candidate=moves[k]) if k in some and f.candidate is not moves[k] else f
            for k, f in enumerate(found)
        ]
        before, after = ([f.candidate for f in each] for each in (found, put))
        if _criterion(r, after) < _criterion(r, before):
            found = put
    return found


def _beside(r: Responses, candidate: Candidate, known: Sequence[Candidate]) -> Candidate | None:
    """The known place that these poses do not resolve from a candidate's, the nearest."""
    name = candidate.effect.place
    if not name or candidate.shape.series:
        return None
    alike = [c for c in known if c.label == candidate.label and not c.is_distinct(r, candidate)]
    return min(alike, key=lambda c: abs(c.shape.at[name] - candidate.shape.at[name]), default=None)


def _criterion(r: Responses, model: Sequence[Candidate]) -> float:
    """−2 log likelihood plus log n for each parameter."""
    parameters = sum(c.parameters for c in model)
    return fitted_model(r, model).fitted.criterion + float(np.log(len(r))) * parameters
