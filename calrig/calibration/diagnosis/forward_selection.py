"""Forward selection: which candidates may enter a model, and what enters with the best of them.

The best candidate enters alone, with the further terms of its series that the model needs, or as one of two
effects that hide each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.diagnosis.candidates import Candidate, companions_of, model_columns
from calrig.calibration.diagnosis.ranking import COMPANION_MARGIN, MARGIN, SelectedEffect, named, pair
from calrig.calibration.diagnosis.reselection import Rivals, is_on_trial, penalised_criterion
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.diagnosis.significance_test import Verdict
from calrig.calibration.regression.noise_model import STRONG_RHO, distance_of, fit
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.run_changes import RUN

LEAST_SHARE = 0.05
"""Least standard deviation of an effect's part of the reading, as a share of the residual's."""
LEAST_STANDARD_ERRORS = 4.0
"""Least size of the parameters that reach the reading, jointly."""
LEAST_OF_A_COMPANION = 3.0
"""The same for the two or three effects declared to accompany one in the model: noise gives one of three so
many standard errors in 0.8 %, one of a hundred candidates four in 0.6 %."""


def is_practically_significant(r: Responses, accepted: Sequence[Candidate], step: SelectedEffect) -> bool:
    """Return whether what a step adds to the reading, beyond bias and scale, is large and certain enough.

    A witness alone names no effect of the reading: the parameters that reach the reading must be several
    standard errors large, and a named effect must not increase the residual of the reading.
    """
    candidate = step.candidate
    before = fit(r, model_columns(r, accepted))
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    own = np.arange(-candidate.columns.shape[2], 0)
    part = candidate.columns[:, 0, :] @ fitted.beta[own]
    line = np.column_stack([np.ones(len(r)), r.theta_deg])
    part = part - line @ np.linalg.lstsq(line, part, rcond=None)[0]
    left_deg, left_before_deg = (
        float(np.hypot(one.residuals[:, 0].std(), r.rounding[0])) for one in (fitted, before)
    )
    reaching = own[np.ptp(candidate.columns[:, 0, :], axis=0) > 0.0]
    beta, covariance = fitted.beta[reaching], fitted.covariance[np.ix_(reaching, reaching)]
    sure = float(np.sqrt(distance_of(beta, covariance)))
    least = LEAST_OF_A_COMPANION if candidate.label in companions_of(accepted) else LEAST_STANDARD_ERRORS
    helps = step.verdict != "named" or left_deg <= left_before_deg
    return part.std() >= LEAST_SHARE * left_deg and sure >= least and helps


def _pruned(
    terms: Sequence[Candidate], criterion: Callable[[Sequence[Candidate]], float], margin: float
) -> Sequence[Candidate]:
    """Drop the least needed of several terms while that costs less than a margin of the criterion."""
    kept = list(terms)
    while len(kept) > 1:
        fewer = min(([term for term in kept if term is not one] for one in kept), key=criterion)
        if criterion(fewer) - criterion(kept) >= margin:
            break
        kept = fewer
    return kept


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

    Args:
        r: the responses.
        accepted: the effects in the model.
        best: the best candidate.
        verdict: of the test that it passed.
        judged: tests the candidates in addition to a model.
        rivals: in a fold, the competing candidates of all poses; no other pairs are tried.
    """
    if best.candidate.beside is None:
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
        members = _pruned(
            members,
            lambda kept: fitted_model(r, [*accepted, *kept]).fitted.criterion + bic_penalty * len(kept),
            0.0,
        )
    if best.candidate.shape.series:
        members = _pruned(members, lambda kept: penalised_criterion(r, [*accepted, *kept]), MARGIN)
    return [replace(best, candidate=member) for member in members]


def masked_pair(
    r: Responses, model: Model, verdict: Verdict, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """Return two effects that mask each other: each alone leaves the other, which looks like slow noise."""
    if model.fitted.noise.rho.max() < STRONG_RHO or not verdict.candidates:
        return []
    first = named(r, model.accepted, verdict.candidates, verdict.ratios, verdict.p_value)
    return tested_pair(r, model, first, judged)


def tested_pair(
    r: Responses, model: Model, first: SelectedEffect, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """Return an effect and the best one in addition to it, if each passes with the other in the model.

    This admits effects that are not significant alone, such as a slip that a warm-up cancels in the reading.
    """
    beside = [*model.accepted, first.candidate]
    of_second = judged(fitted_model(r, beside))
    if not of_second.passes:
        return []
    second = named(r, beside, of_second.candidates, of_second.ratios, of_second.p_value)
    with_second = [*model.accepted, second.candidate]
    of_first = judged(fitted_model(r, with_second))
    worth = is_practically_significant(r, beside, second) and is_practically_significant(
        r, with_second, first
    )
    if not of_first.passes or not worth:
        return []
    both = (replace(first, p_value=of_first.p_value), second)
    return [replace(one, candidate=member) for one in both for member in one.candidate.members]


def simplest(
    r: Responses, accepted: Sequence[Candidate], best: SelectedEffect, verdict: Verdict
) -> SelectedEffect:
    """Return the best candidate; of several effects offered as one, a single one that explains as much."""
    if best.candidate.beside is None or not _says_no_more(best, verdict.candidates):
        return best
    single = [k for k, c in enumerate(verdict.candidates) if c.beside is None]
    offered = [verdict.candidates[k] for k in single]
    return named(r, accepted, offered, verdict.ratios[single], verdict.p_value)


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
