"""Places that no coefficient gives, such as a period: refined by the likelihood, with their standard errors.

Gauss-Newton: the model's change with the place, at the coefficients fitted, is one more column; its
coefficient is the step to take, and its variance the place's (Seber & Wild, Nonlinear Regression, 1989,
section 2.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.candidates import Candidate, candidate_at
from calrig.calibration.effect import Parameters
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import fitted_model
from calrig.estimation.angles import FloatArray

STEPS = 5
CLOSE = 0.05
"""Standard errors of the place: a smaller step changes nothing."""
NUDGE = 1e-5
"""Of a place, to either side: its slope by difference."""


def slope(r: Responses, candidate: Candidate, beta: FloatArray) -> FloatArray:
    """(n, J, 1) change of what a candidate adds with its effect's place, at coefficients beta (p,)."""
    name, at = candidate.effect.place, candidate.shape.at
    nudge = NUDGE * abs(at[name])
    above, below = (_moved(r, candidate, {**at, name: at[name] + side}) for side in (nudge, -nudge))
    change = (above.columns - below.columns) @ beta / (2.0 * nudge)
    return np.asarray(change[:, :, None], dtype=np.float64)


def refined(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> tuple[Fit, Candidate]:
    """A candidate at the best place near its own, and the fit of the model with it.

    A term of a series stays where it is: its place is known.
    """
    name = candidate.effect.place
    model = fitted_model(r, accepted)
    r, accepted = model.responses, model.accepted
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    for _ in range(0 if candidate.shape.series else STEPS):
        step, std = _step(r, accepted, candidate, fitted)
        place = candidate.shape.at[name]
        moved, better = candidate, fitted
        while abs(step) > CLOSE * std and abs(step) < 0.5 * abs(place):
            moved = _moved(r, candidate, {**candidate.shape.at, name: place + step})
            better = fit(r, model_columns(r, [*accepted, moved]))
            if better.criterion < fitted.criterion and _is_distinct(r, accepted, moved):
                break
            step /= 4.0
            moved, better = candidate, fitted
        if moved is candidate:
            break
        candidate, fitted = moved, better
    _, std = _step(r, accepted, candidate, fitted)
    return _settled(r, accepted, candidate, fitted, {name: std})


def _is_distinct(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> bool:
    return all(candidate.is_distinct(r, other) for other in accepted)


def _step(
    r: Responses, accepted: Sequence[Candidate], candidate: Candidate, fitted: Fit
) -> tuple[float, float]:
    """By how much the place should move, and its standard error."""
    own = fitted.beta[-candidate.columns.shape[2] :]
    columns = np.concatenate(
        [model_columns(r, [*accepted, candidate]), slope(r, candidate, own)],
        axis=2,
    )
    moving = fit(r, columns)
    return float(moving.beta[-1]), math.sqrt(max(float(moving.covariance[-1, -1]), 0.0))


def _settled(
    r: Responses, accepted: Sequence[Candidate], candidate: Candidate, fitted: Fit, std: Parameters
) -> tuple[Fit, Candidate]:
    at = candidate.effect.settled(candidate.shape.at, std)
    settled = candidate if at == candidate.shape.at else _moved(r, candidate, at)
    if settled is not candidate and _is_distinct(r, accepted, settled):
        candidate = settled
        fitted = fit(r, model_columns(r, [*accepted, candidate]))
    return fitted, replace(candidate, shape=replace(candidate.shape, at_std=std))


def _moved(r: Responses, candidate: Candidate, at: Parameters) -> Candidate:
    """The same form at another place."""
    (shape,) = candidate.effect.forms(r, at)
    return candidate_at(r, candidate, shape)
