"""Families: the harmonics of a worm, a motor or a scale have its period, and move with it.

A search finds waves one by one, and refines each while others are missing. Strong ones leave more than the
noise then, so that each period is a little wrong, and with it the harmonics offered of it. Harmonic k tells
the period k times as well as the first wave does. So a family is refined together (Quinn & Thomson,
Biometrika 78, 1991, on the frequency of a periodic function).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.diagnosis.candidate_fits import CLOSE, moved, slope
from calrig.calibration.diagnosis.candidates import Candidate, is_term_of, own_columns, term_alike
from calrig.calibration.diagnosis.ranking import SelectedEffect, at_best_place, candidates_in
from calrig.calibration.diagnosis.reselection import penalised_criterion
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.regression.effect import OF
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

STEPS, HALVINGS = 4, 3
LEAST_GAIN = 0.01
"""Of −2 log likelihood with penalties, for which a family takes the place of its waves."""


def with_families(r: Responses, found: list[SelectedEffect], known: int = 0) -> list[SelectedEffect]:
    """Tie what may be a harmonic of another wave to it, and refine them together, where the model improves.

    The first `known` effects were found in another base, and stay.
    """
    found = with_free_orphans(r, found)
    for k in range(known, len(found)):
        terms = _terms(r, found[known:], found[k])
        if terms:
            tied = _refined(r, found, found[k], terms)
            before, after = (penalised_criterion(r, candidates_in(each)) for each in (found, tied))
            if after < before - LEAST_GAIN:
                found = tied
    return found


def with_free_orphans(r: Responses, found: list[SelectedEffect]) -> list[SelectedEffect]:
    """Give each harmonic whose first wave has left the model a period of its own."""
    for k, f in enumerate(found):
        one, others = f.candidate, candidates_in(other for other in found if other is not f)
        has_first = one.shape.at.get(OF) in (None, *r.known_periods_deg)
        if not has_first and not any(is_term_of(one, other) for other in others):
            place = one.effect.place
            free = moved(r, one, {place: one.shape.at[place]})
            found = [*found[:k], replace(f, candidate=at_best_place(r, others, free)), *found[k + 1 :]]
    return found


def place_slope(model: Model, own: Sequence[slice], k: int) -> FloatArray:
    """Return (n, J, 1) change of the responses with the place of the k-th effect, on which its terms depend.

    `own` are the columns of each accepted effect.
    """
    first = model.accepted[k]
    name, change = first.effect.place, slope(model.responses, first, model.fitted.beta[own[k]])
    for c, at in zip(model.accepted, own, strict=True):
        if is_term_of(c, first):
            share = c.shape.at[name] / first.shape.at[name]
            change = change + share * slope(model.responses, c, model.fitted.beta[at])
    return change


def _terms(
    r: Responses, found: Sequence[SelectedEffect], first: SelectedEffect
) -> dict[SelectedEffect, Candidate]:
    """Return the effects that may be further terms of one, each as that term.

    What has terms that are not among them stays the first of its own.
    """
    alike = {f: term_alike(r, first.candidate, f.candidate) for f in found}
    may_be = {f: term for f, term in alike.items() if term is not None}
    left = [f.candidate for f in found if f not in may_be]
    return {f: t for f, t in may_be.items() if not any(is_term_of(c, f.candidate) for c in left)}


def _refined(
    r: Responses,
    found: Sequence[SelectedEffect],
    first: SelectedEffect,
    terms: Mapping[SelectedEffect, Candidate],
) -> list[SelectedEffect]:
    """Gauss-Newton steps of the place of a cause with all its terms, each as long as it improves the fit."""
    name, k = first.candidate.effect.place, found.index(first)
    place = start = first.candidate.shape.at[name]
    is_known = bool(first.candidate.shape.series)  # an order of the turn

    def at(there: float) -> list[SelectedEffect]:
        put = list(found)
        for m, f in enumerate(found):
            one = first.candidate if f is first else terms.get(f)
            if one is not None:
                places = {
                    key: v * there / start if key in (name, OF) else v for key, v in one.shape.at.items()
                }
                put[m] = replace(f, candidate=moved(r, one, places))
        return put

    best, std = at(place), 0.0
    for _ in range(0 if is_known else STEPS):
        model = fitted_model(r, candidates_in(best))
        own = own_columns(model.columns, model.accepted)
        moving = fit(model.responses, np.concatenate([model.columns, place_slope(model, own, k)], axis=2))
        step, std = float(moving.beta[-1]), math.sqrt(max(float(moving.covariance[-1, -1]), 0.0))
        steps = [step / 4.0**m for m in range(HALVINGS) if abs(step) / 4.0**m > CLOSE * std]
        tried = ((place + one, at(place + one)) for one in steps if abs(one) < 0.5 * place)
        least = model.fitted.criterion
        better = next(
            (t for t in tried if fitted_model(r, candidates_in(t[1])).fitted.criterion < least), None
        )
        if better is None:
            break
        place, best = better
    shape = replace(best[k].candidate.shape, at_std=first.candidate.shape.at_std if is_known else {name: std})
    best[k] = replace(best[k], candidate=replace(best[k].candidate, shape=shape))
    return best
