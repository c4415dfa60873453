"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from calrig.calibration.backward import parted, tenable
from calrig.calibration.candidates import Candidate
from calrig.calibration.channels import READING
from calrig.calibration.effect import HIDDEN
from calrig.calibration.gate import Verdict, gate
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import Fit, fit, noise_of
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.ranking import Found, named, pair
from calrig.calibration.responses import Responses
from calrig.calibration.run_changes import is_level, with_free_levels
from calrig.calibration.screen import Screen
from calrig.calibration.sensor_model import Model, fitted_model
from calrig.calibration.series import needed, needed_changes, on_their_places
from calrig.estimation.angles import FloatArray

LEVEL = 0.01
"""The nominal rate at which a search of noise alone says something."""
MOST_EFFECTS, MOST_COLUMNS = 5, 0.35
"""A series, such as the orders of a turn, is one effect of several terms; columns to a pose at most."""
FREEDOM = 3
LEAST_SHARE = 0.05
"""An effect whose part of the reading is smaller than this share of its noise is not worth a correction."""
COMPANION_MARGIN = 3.0
"""Of the criterion, by which an effect must pay for the one companion that it is declared to have: with the
penalty a likelihood ratio beyond 7, which one parameter reaches in noise in less than 1 of 100.
"""
LEAST_STANDARD_ERRORS = 4.0
"""Of the parameters that reach the reading, together: what a witness alone shows is not named."""


@dataclass(frozen=True, slots=True)
class Findings:
    """What a search found, and the fit of the model it arrived at.

    Attributes:
        responses: the poses it rests on; `kept` (m,) are their indices among those it was given.
    """

    responses: Responses
    kept: npt.NDArray[np.intp]
    found: tuple[Found, ...]
    fitted: Fit
    columns: FloatArray
    p_value_left: float
    least_p_value: float
    """What the bootstrap could have told at best."""


def search(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    *,
    bootstraps: int,
    level: float = LEVEL,
    decide_only: bool = False,
) -> Findings:
    """Finds the effects in some poses, and leaves outliers among those aside.

    Of several runs first those that show within them, each run with a bias of its own, then what the biases
    differ by, at half the level each.

    Args:
        r: the responses.
        candidates: of these poses (`candidates_of`).
        rng: of the gate's bootstrap.
        bootstraps: how many a step.
        level: of the gate.
        decide_only: whether no p-value will be told.
    """
    judge = partial(gate, rng=rng, bootstraps=bootstraps, decide_only=decide_only)
    if len(r.run_ids) < 2:
        return _search(r, candidates, partial(judge, level=level))
    levels = [is_level(r, c.columns) for c in candidates]
    shapes = [c for c, of_level in zip(candidates, levels, strict=True) if not of_level]
    judge = partial(judge, level=level / 2.0)
    within = _search(with_free_levels(r), shapes, judge)
    kept = within.kept
    # what a place was scanned for shows within the runs or not at all
    between = [
        c.rows(kept)
        for c, of_level in zip(candidates, levels, strict=True)
        if of_level or not any(member.shape.scanned for member in c.members)
    ]
    # levels that differ look like noise that wanders: what wanders within the runs is the measure of it
    of_each = max(1.0, within.columns.shape[2] / len(r.channels))
    noise = noise_of(within.fitted.residuals, within.responses, of_each, unbiased=True)
    whole = _search(r.rows(kept), between, partial(judge, noise=noise), within.found)
    return replace(whole, kept=kept[whole.kept])


def _search(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    known: Sequence[Found] = (),
) -> Findings:
    """The search in one base, with effects in the model that are known already; `judge` is the gate.

    Round by round: the model is fitted and the best of all candidates judged; a pose gone wrong is left out,
    or the search ends; what passed is named, enters, and is held against its rivals with all the others; what
    cannot be, or is not needed any more, leaves.
    """
    found = list(known)
    refused: set[str] = set()
    kept = np.arange(len(r))
    fewest = len(r) - most_outliers(len(r))

    def judged(model: Model) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> FloatArray:
            return model_columns(model.responses, [*model.accepted, *more])

        offered = _offered(model.responses, candidates, model.accepted, refused)
        return judge(model.responses, columns_with, model.fitted, offered)

    while True:
        accepted = [f.candidate for f in found]
        model = fitted_model(r, accepted)
        verdict = judged(model)
        wild = outlier(model.responses, model.accepted, verdict.gain) if len(kept) > fewest else None
        if wild is not None:
            others = np.delete(np.arange(len(r)), wild)
            kept, r, candidates = kept[others], r.rows(others), [c.rows(others) for c in candidates]
            found = [f.rows(others) for f in found]
            continue
        if not verdict.passes or _is_full(accepted, len(known)):
            p_values = verdict.p_value, verdict.least_p_value
            return Findings(r, kept, tuple(found), model.fitted, model.columns, *p_values)
        best = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
        if not _is_worth_a_name(r, accepted, best):
            refused.add(best.candidate.label)
            continue
        best = _plain(r, accepted, best, verdict)
        entering = _entering(r, accepted, best, verdict, judged)
        entered = _reconsidered(r, candidates, [*found, *entering], len(known))
        entered = on_their_places(r, candidates, entered)
        if found and not tenable(r, [f.candidate for f in entered]):
            refused.add(best.candidate.label)
            continue
        found, dropped = parted(r, entered, len(known))
        refused.update(dropped)


def _entering(
    r: Responses,
    accepted: Sequence[Candidate],
    best: Found,
    verdict: Verdict,
    judged: Callable[[Model], Verdict],
) -> list[Found]:
    """The best candidate's effects, of a series those needed; or two that together explain far more.

    Of these the second has to pass beside the first.
    """
    if best.candidate.beside is None:
        two = pair(r, accepted, verdict.candidates, verdict.ratios, best)
        of_second = two and judged(fitted_model(r, [*accepted, two[0]]))
        if two and of_second and of_second.passes:
            second = replace(best, candidate=two[1], rivals=(), p_value=of_second.p_value)
            return [replace(best, candidate=two[0], rivals=()), second]
    members: Sequence[Candidate] = needed_changes(r, accepted, best.candidate)
    if best.candidate.shape.series:
        members = needed(r, accepted, members)
    return [replace(best, candidate=member) for member in members]


def _plain(r: Responses, accepted: Sequence[Candidate], best: Found, verdict: Verdict) -> Found:
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
    forms = sum(c.label == step.candidate.label for c in offered)
    margin = COMPANION_MARGIN + 2.0 * float(np.log(max(forms, 1)))
    return any(behind.get(member.label, np.inf) < margin for member in step.candidate.members)


def _is_full(accepted: Sequence[Candidate], known: int) -> bool:
    """Whether the model has as many effects, but the first known ones, as a run is searched for."""
    if len(accepted) == known:
        return False
    own = accepted[known:]
    series = {c.shape.series for c in own if c.shape.series}
    alone = sum(not c.shape.series for c in own)
    columns = sum(c.columns.shape[2] for c in accepted)
    return len(series) + alone >= MOST_EFFECTS or columns > MOST_COLUMNS * len(accepted[0].columns)


def _offered(
    r: Responses, candidates: Sequence[Candidate], accepted: Sequence[Candidate], refused: set[str]
) -> list[Candidate]:
    """The candidates that may enter now: not those that have, nor those that follow on what has not.

    Nor those that leave the reading hardly a degree of freedom to judge them by.
    """
    taken = sum(name.startswith(READING) for name in r.base_names)
    room = len(r) - taken - sum(c.columns.shape[2] for c in accepted) - FREEDOM
    present = {c.name for c in accepted}
    followed = {c.covariate for c in accepted}
    always = {c.name for c in accepted if c.changed is None}
    once = {c.label for c in accepted if c.named and _enters_once(c)}

    def may_enter(c: Candidate) -> bool:
        if c.columns.shape[2] > room:
            return False
        if c.beside is not None:
            return not any(one.label in once or one.name in always for one in c.members)
        if c.shape.beside and not followed.issuperset(c.shape.beside):
            return False
        if c.label in once or not (c.follows is None or c.follows in present):
            return False
        return c.effect.distinct is None or all(c.is_distinct(r, other) for other in accepted)

    return [c for c in candidates if c.label not in refused and may_enter(c)]


def _enters_once(c: Candidate) -> bool:
    """Whether a second would say the same: it has no place, or one that its likelihood is smooth in."""
    return c.shape.at.keys() <= set(HIDDEN) or c.shape.place_cost == 1


def _reconsidered(
    r: Responses, candidates: Sequence[Candidate], found: list[Found], known: int
) -> list[Found]:
    """Each effect but the first known ones against its rivals once more, with all the others in the model."""
    if len(found) == known + 1:
        return found
    for one in found[known:]:
        others = [f.candidate for f in found if f is not one]
        offered = _offered(r, candidates, others, set())
        if one.candidate.shape.series:  # a curve takes a little from every term: the terms come first
            offered = [c for c in offered if c.named]
        model = fitted_model(r, others)
        screen = Screen(r, model.columns, offered, model.fitted.noise)
        ratios = screen.once(model.fitted.residuals)
        again = named(r, others, offered, ratios, one.p_value, one.candidate)
        place = next(k for k, f in enumerate(found) if f is one)
        found[place : place + 1] = [replace(again, candidate=member) for member in again.candidate.members]
    return found


def _is_worth_a_name(r: Responses, accepted: Sequence[Candidate], step: Found) -> bool:
    """Whether what a step adds to the reading, bias and scale taken off, is worth a correction, and sure.

    What a witness alone shows, names no effect of the reading: parameters that reach the reading are some
    standard errors large, and where the effect is named, the reading is not left worse than without it.
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
    sure = float(np.sqrt(beta @ np.linalg.pinv(covariance, hermitian=True) @ beta))
    helps = step.verdict != "named" or left_deg <= left_before_deg
    return part.std() >= LEAST_SHARE * left_deg and sure >= LEAST_STANDARD_ERRORS and helps
