"""What enters a model: the best alone, with a companion, or two effects that hide each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.gate import Verdict
from calrig.calibration.near_rivals import Rivals
from calrig.calibration.noise_model import STRONG_RHO
from calrig.calibration.ranking import COMPANION_MARGIN, Found, named, pair
from calrig.calibration.responses import Responses
from calrig.calibration.sensor_model import Model, fitted_model
from calrig.calibration.series import needed, needed_changes
from calrig.calibration.worth import is_worth_a_name


def entering(
    r: Responses,
    accepted: Sequence[Candidate],
    best: Found,
    verdict: Verdict,
    judged: Callable[[Model], Verdict],
    rivals: Rivals | None = None,
) -> list[Found]:
    """The best candidate's effects, of a series those needed; or two that together explain far more.

    Of these the second has to pass beside the first. A fold tries no two but of what all poses show.
    """
    if best.candidate.beside is None:
        shown = [k for k, c in enumerate(verdict.candidates) if rivals is None or c.label in rivals]
        offered = [verdict.candidates[k] for k in shown]
        two = pair(r, accepted, offered, verdict.ratios[shown], best)
        of_second = two and judged(fitted_model(r, [*accepted, two[0]]))
        if two and of_second and of_second.passes:
            second = replace(best, candidate=two[1], rivals=(), p_value=of_second.p_value)
            return [replace(best, candidate=two[0], rivals=()), second]
    members: Sequence[Candidate] = needed_changes(r, accepted, best.candidate)
    if best.candidate.shape.series:
        members = needed(r, accepted, members)
    return [replace(best, candidate=member) for member in members]


def hidden(r: Responses, model: Model, verdict: Verdict, judged: Callable[[Model], Verdict]) -> list[Found]:
    """Two effects of which each alone leaves the other, which then looks like noise that wanders."""
    if model.fitted.noise.rho.max() < STRONG_RHO or not verdict.candidates:
        return []
    first = named(r, model.accepted, verdict.candidates, verdict.ratios, verdict.p_value)
    return with_another(r, model, first, judged)


def with_another(r: Responses, model: Model, first: Found, judged: Callable[[Model], Verdict]) -> list[Found]:
    """An effect on trial and the best beside it, where each passes the gate beside the other.

    So enters what is worth no name alone: a slip that a warm-up undoes makes the reading worse without it.
    """
    beside = [*model.accepted, first.candidate]
    of_second = judged(fitted_model(r, beside))
    if not of_second.passes:
        return []
    second = named(r, beside, of_second.candidates, of_second.ratios, of_second.p_value)
    with_second = [*model.accepted, second.candidate]
    of_first = judged(fitted_model(r, with_second))
    worth = is_worth_a_name(r, beside, second) and is_worth_a_name(r, with_second, first)
    if not of_first.passes or not worth:
        return []
    both = (replace(first, p_value=of_first.p_value), second)
    return [replace(one, candidate=member) for one in both for member in one.candidate.members]


def plain(r: Responses, accepted: Sequence[Candidate], best: Found, verdict: Verdict) -> Found:
    """The best candidate; of several effects offered as one, one alone where that says as much."""
    if best.candidate.beside is None or not _says_no_more(best, verdict.candidates):
        return best
    single = [k for k, c in enumerate(verdict.candidates) if c.beside is None]
    offered = [verdict.candidates[k] for k in single]
    return named(r, accepted, offered, verdict.ratios[single], verdict.p_value)


def _says_no_more(step: Found, offered: Sequence[Candidate]) -> bool:
    """Whether one of several effects offered as one explains the poses nearly as well by itself.

    The more forms the two have together, the more of them fit noise a little better than one.
    """
    behind = dict(step.considered)
    same = [c for c in offered if c.label == step.candidate.label]
    # an instant has paid for its choice among all of them
    forms = len({tuple(m.shape.form for m in c.members) for c in same} if is_on_trial(same[0]) else same)
    margin = COMPANION_MARGIN + 2.0 * float(np.log(max(forms, 1)))
    return any(behind.get(member.label, np.inf) < margin for member in step.candidate.members)


def is_on_trial(candidate: Candidate) -> bool:
    """Whether it is a pair of which one was chosen among places that differ from one to the next."""
    return len(candidate.members) > 1 and any(
        m.shape.scanned and m.shape.place_cost > 1 for m in candidate.members
    )


def brings(pair: Candidate, one: Candidate) -> bool:
    """Whether an effect is among several that are offered as one."""
    return any(member.label == one.label for member in pair.members)
