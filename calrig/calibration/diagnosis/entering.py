"""What enters a model: one effect that passes the significance test, or two that hide each other.

An effect enters alone, or with the further terms of its series that the model needs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    at_its_elevations,
    companions_of,
    is_order_beside,
    model_columns,
)
from calrig.calibration.diagnosis.lack_of_fit import is_of_rounding
from calrig.calibration.diagnosis.ranking import COMPANION_MARGIN, SelectedEffect, named, pair
from calrig.calibration.diagnosis.reselection import Rivals, is_on_trial, needed_terms, pruned
from calrig.calibration.diagnosis.screen import Float32Array
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.diagnosis.significance_test import Verdict
from calrig.calibration.regression.noise_model import STRONG_RHO, distance_of, fit
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.run_changes import RUN
from calrig.calibration.regression.terms import less_line

LEAST_SHARE = 0.05
"""Least standard deviation of an effect's part of the reading, as a share of the residual's."""
LEAST_STANDARD_ERRORS = 4.0
"""Least size of the parameters that reach the reading, jointly."""
LEAST_OF_A_COMPANION = 3.0
"""The same for the two or three effects declared to accompany one in the model: noise gives one of three so
many standard errors in 0.8 %, one of a hundred candidates four in 0.6 %."""


def is_practically_significant(r: Responses, accepted: Sequence[Candidate], step: SelectedEffect) -> bool:
    """Return whether what a step adds to the reading, beyond bias and scale, is large and certain enough.

    A witness alone names no effect: the parameters that reach the reading must be several standard errors
    large, and a named effect must not increase its residual.
    """
    candidate, seen = step.candidate, fitted_model(r, accepted)
    if seen.responses.is_delayed:  # at one's own elevations, late readings hide what is small
        r, accepted = seen.responses, seen.accepted
        candidate = at_its_elevations(r, candidate)
    before = fit(r, model_columns(r, accepted))
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    own = np.arange(-candidate.columns.shape[2], 0)
    part = candidate.columns[:, 0, :] @ fitted.beta[own]
    part = less_line(r, part)
    left_deg, left_before_deg = (
        float(np.hypot(one.residuals[:, 0].std(), r.rounding[0])) for one in (fitted, before)
    )
    reaching = own[np.ptp(candidate.columns[:, 0, :], axis=0) > 0.0]
    beta, covariance = fitted.beta[reaching], fitted.covariance[np.ix_(reaching, reaching)]
    sure = float(np.sqrt(distance_of(beta, covariance)))
    least = least_standard_errors(candidate, accepted)
    helps = step.verdict != "named" or left_deg <= left_before_deg
    return part.std() >= LEAST_SHARE * left_deg and sure >= least and helps


def least_standard_errors(candidate: Candidate, accepted: Sequence[Candidate]) -> float:
    """Return how many standard errors an effect's size must have beside others."""
    return LEAST_OF_A_COMPANION if candidate.label in companions_of(accepted) else LEAST_STANDARD_ERRORS


def forward_step(
    r: Responses,
    accepted: Sequence[Candidate],
    best: SelectedEffect,
    verdict: Verdict,
    judged: Callable[[Model], Verdict],
    rivals: Rivals | None = None,
) -> list[SelectedEffect]:
    """Return the effects of the best candidate, or of two that together explain far more.

    Of two the second must pass the significance test with the first in the model. Of a series, such as the
    orders of a turn, or of several changes between runs only the needed terms enter.

    `verdict` is of the test that `best` passed; `judged` tests the candidates in addition to a model. In a
    fold, `rivals` are the competing candidates of all poses: no other pairs are tried.
    """
    if best.candidate.beside is None and not _leaves_rounding(r, [*accepted, best.candidate]):
        shown = [k for k, c in enumerate(verdict.candidates) if rivals is None or c.label in rivals.labels]
        offered = [verdict.candidates[k] for k in shown]
        two = pair(r, accepted, offered, verdict.ratios[shown], best)
        of_second = two and judged(fitted_model(r, [*accepted, two[0]]))
        if two and of_second and of_second.passes:
            second = replace(best, candidate=two[1], rivals=(), p_value=of_second.p_value)
            return [replace(best, candidate=two[0], rivals=()), second]
    members: Sequence[Candidate] = best.candidate.members
    if best.candidate.effect.covariate is RUN:  # a change between runs costs one parameter
        bic_penalty = float(np.log(len(r)))
        members = pruned(
            members,
            lambda kept: fitted_model(r, [*accepted, *kept]).fitted.criterion + bic_penalty * len(kept),
            0.0,
        )
    members = needed_terms(r, accepted, members)
    entering = [replace(best, candidate=member) for member in members]
    if len(entering) == 1 and is_order_beside(best.candidate, accepted):
        # that some of the orders are there is significant: this one has to be certain by itself
        return entering if is_practically_significant(r, accepted, entering[0]) else []
    return entering


def masked_pair(
    r: Responses, model: Model, verdict: Verdict, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """Return two effects that mask each other: each alone leaves the other, which looks like slow noise."""
    first = likeliest(r, model, verdict)
    if first is None:
        return []
    few, ratios = _without_series(verdict)
    two = pair(r, model.accepted, few, ratios, first)
    of_two = two and tested_pair(r, model, replace(first, candidate=two[0], rivals=()), judged)
    return of_two or tested_pair(r, model, first, judged)


@lru_cache(maxsize=1)
def likeliest(r: Responses, model: Model, verdict: Verdict) -> SelectedEffect | None:
    """Return the best of the candidates where something may hide it: what is left looks like slow noise."""
    few, ratios = _without_series(verdict)
    if model.fitted.noise.rho.max() < STRONG_RHO or not few:
        return None
    best = named(r, model.accepted, few, ratios, verdict.p_value)
    return best if best.considered else None


def tested_pair(
    r: Responses, model: Model, first: SelectedEffect, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """Return an effect and the best one in addition to it, if each passes with the other in the model.

    This admits effects that are not significant alone, such as a slip that a warm-up cancels in the reading.
    """
    beside = [*model.accepted, first.candidate]
    of_second = judged(fitted_model(r, beside))
    few, ratios = _without_series(of_second)
    if not of_second.passes or not few:
        return []
    second = named(r, beside, few, ratios, of_second.p_value)
    with_second = [*model.accepted, second.candidate]
    worth = is_practically_significant(r, beside, second) and is_practically_significant(
        r, with_second, first
    )
    if not worth:
        return []
    of_first = judged(fitted_model(r, with_second))
    if not of_first.passes:
        return []
    both = (replace(first, p_value=of_first.p_value), second)
    return [replace(one, candidate=member) for one in both for member in one.candidate.members]


def _without_series(verdict: Verdict) -> tuple[list[Candidate], Float32Array]:
    """Return the candidates that were judged, and their ratios, without those that are many terms as one."""
    few = [k for k, c in enumerate(verdict.candidates) if c.beside is None or not c.shape.series]
    return [verdict.candidates[k] for k in few], verdict.ratios[few]


def simplest(
    r: Responses, accepted: Sequence[Candidate], best: SelectedEffect, verdict: Verdict
) -> SelectedEffect:
    """Return the best candidate; of several effects offered as one, a single one that explains as much.

    Or one that leaves no more than rounding does.
    """
    single = [k for k, c in enumerate(verdict.candidates) if c.beside is None]
    waves = [k for k in single if verdict.candidates[k].columns.shape[2] <= 2]
    first = max(waves, key=verdict.ratios.__getitem__, default=None)
    if first is not None and _leaves_rounding(r, [*accepted, verdict.candidates[first]]):
        single = waves
    elif best.candidate.beside is None or not _says_no_more(best, verdict.candidates):
        return best
    offered = [verdict.candidates[k] for k in single]
    return named(r, accepted, offered, verdict.ratios[single], verdict.p_value)


def _leaves_rounding(r: Responses, accepted: Sequence[Candidate]) -> bool:
    model = fitted_model(r, accepted)
    return is_of_rounding(model.responses, model.fitted.residuals[:, 0])


def _says_no_more(step: SelectedEffect, offered: Sequence[Candidate]) -> bool:
    """Return whether one of several effects offered as one explains the poses nearly as well by itself.

    The margin grows with the number of forms of the pair: among more forms, one fits noise better by chance.
    """
    behind = dict(step.considered)
    same = [c for c in offered if c.label == step.candidate.label]
    # A scanned instant has already paid for being chosen among all of them.
    forms = len({tuple(m.shape.form for m in c.members) for c in same} if is_on_trial(same[0]) else same)
    margin = COMPANION_MARGIN + 2.0 * float(np.log(max(forms, 1)))
    return any(behind.get(member.label, np.inf) < margin for member in step.candidate.members)


def entering(
    r: Responses,
    model: Model,
    accepted: Sequence[Candidate],
    verdict: Verdict,
    judged: Callable[[Model], Verdict],
    rivals: Rivals | None,
) -> tuple[list[SelectedEffect], str | None]:
    """Return the effects that enter, or none and the label of one that is significant but of no worth."""
    if not verdict.passes:
        return [step.at_elevations_of(r) for step in masked_pair(r, model, verdict, judged)], None
    steps: list[SelectedEffect] = []
    best = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
    if best.considered and is_practically_significant(r, accepted, best):
        best = simplest(r, accepted, best, verdict)
        steps = forward_step(r, accepted, best, verdict, judged, rivals)
    elif best.considered and companions_of([best.candidate]):
        steps = tested_pair(r, model, best, judged)
    return [step.at_elevations_of(r) for step in steps], None if steps else best.candidate.label
