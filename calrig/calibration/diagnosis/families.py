"""Families: the harmonics of a worm, a motor or a scale have its period, and move with it.

A search finds waves one by one, and refines each while others are missing: of strong ones, each period is off
by more than the noise allows, and so are the harmonics that follow the first of them. Harmonic k tells the
period k times as well as the first one does, so all of a family are refined together (Quinn & Thomson,
Biometrika 78, 1991, on the frequency of a periodic function).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.diagnosis.candidate_fits import CLOSE, moved, slope
from calrig.calibration.diagnosis.candidates import Candidate, follows, own_columns, term_alike
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.reselection import penalised_criterion
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.regression.effect import OF
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

STEPS, HALVINGS = 4, 3
SAME = 0.01
"""Of −2 log likelihood: what improves a model by less is where it was."""


def with_families(r: Responses, found: list[SelectedEffect]) -> list[SelectedEffect]:
    """Tie what may be a harmonic of another wave to it, and refine them together, where the model improves.

    Args:
        r: the responses.
        found: the effects of a model.
    """
    for k in range(len(found)):
        terms = _terms(r, found, found[k])
        if terms:
            tied = _refined(r, found, found[k], terms)
            before, after = (penalised_criterion(r, _candidates(each)) for each in (found, tied))
            if after < before - SAME:
                found = tied
    return found


def place_slope(model: Model, own: Sequence[slice], k: int) -> FloatArray:
    """Return (n, J, 1) change of the responses with the place of the k-th effect, on which its terms depend.

    Args:
        model: with its fit.
        own: the columns of each accepted effect.
        k: which of them.
    """
    first = model.accepted[k]
    name, change = first.effect.place, slope(model.responses, first, model.fitted.beta[own[k]])
    for c, at in zip(model.accepted, own, strict=True):
        if follows(c, first):
            share = c.shape.at[name] / first.shape.at[name]
            change = change + share * slope(model.responses, c, model.fitted.beta[at])
    return change


def _terms(
    r: Responses, found: Sequence[SelectedEffect], first: SelectedEffect
) -> dict[SelectedEffect, Candidate]:
    """Return the effects that may be further terms of one, each as that term.

    What has terms of its own stays the first of them.
    """
    alike = {f: term_alike(r, first.candidate, f.candidate) for f in found}
    may_be = {f: term for f, term in alike.items() if term is not None}
    has_own = {f for f in may_be if any(term_alike(r, f.candidate, g.candidate) is not None for g in found)}
    return {f: term for f, term in may_be.items() if f not in has_own}


def _refined(
    r: Responses,
    found: Sequence[SelectedEffect],
    first: SelectedEffect,
    terms: Mapping[SelectedEffect, Candidate],
) -> list[SelectedEffect]:
    """Gauss-Newton steps of the place of a cause with all its terms, each as long as it improves the fit."""
    name, k = first.candidate.effect.place, found.index(first)
    place = start = first.candidate.shape.at[name]

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
    for _ in range(STEPS):
        model = fitted_model(r, _candidates(best))
        own = own_columns(model.columns, model.accepted)
        moving = fit(model.responses, np.concatenate([model.columns, place_slope(model, own, k)], axis=2))
        step, std = float(moving.beta[-1]), math.sqrt(max(float(moving.covariance[-1, -1]), 0.0))
        steps = [step / 4.0**m for m in range(HALVINGS) if abs(step) / 4.0**m > CLOSE * std]
        tried = ((place + one, at(place + one)) for one in steps if abs(one) < 0.5 * place)
        least = model.fitted.criterion
        better = next((t for t in tried if fitted_model(r, _candidates(t[1])).fitted.criterion < least), None)
        if better is None:
            break
        place, best = better
    shape = replace(best[k].candidate.shape, at_std={name: std})
    best[k] = replace(best[k], candidate=replace(best[k].candidate, shape=shape))
    return best


def _candidates(found: Sequence[SelectedEffect]) -> list[Candidate]:
    return [f.candidate for f in found]
