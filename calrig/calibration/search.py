"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.backward import parted, tenable
from calrig.calibration.candidates import Candidate
from calrig.calibration.effect import HIDDEN
from calrig.calibration.gate import Verdict, gate
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import Fit, NoiseModel, fit, noise_of
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.ranking import COMPANION_MARGIN, Found, named, pair
from calrig.calibration.responses import READING, Responses
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
    """
    if len(r.run_ids) < 2:
        return _search(r, candidates, rng, bootstraps, level)
    levels = [is_level(r, c.columns) for c in candidates]
    shapes = [c for c, of_level in zip(candidates, levels, strict=True) if not of_level]
    within = _search(with_free_levels(r), shapes, rng, bootstraps, level / 2.0)
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
    whole = _search(r.rows(kept), between, rng, bootstraps, level / 2.0, within.found, noise)
    return replace(whole, kept=kept[whole.kept])


def _search(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    bootstraps: int,
    level: float,
    known: Sequence[Found] = (),
    noise: NoiseModel | None = None,
) -> Findings:
    """The search in one base, with effects in the model, and the null's noise, that are known already."""
    found = list(known)
    refused: set[str] = set()
    kept = np.arange(len(r))
    fewest = len(r) - most_outliers(len(r))

    def judged(model: Model) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> FloatArray:
            return model_columns(model.responses, [*model.accepted, *more])

        offered = _offered(model.responses, candidates, model.accepted, refused)
        return gate(model.responses, columns_with, model.fitted, offered, rng, bootstraps, level, noise)

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
        if verdict.p_value > level or _is_full(accepted, len(known)):
            least = 1.0 / (bootstraps + 1)
            return Findings(r, kept, tuple(found), model.fitted, model.columns, verdict.p_value, least)
        step = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
        if not _is_worth_a_name(r, accepted, step):
            refused.add(step.candidate.label)
            continue
        if step.candidate.beside is not None and _says_no_more(step, verdict.candidates):
            single = [k for k, c in enumerate(verdict.candidates) if c.beside is None]
            offered = [verdict.candidates[k] for k in single]
            step = named(r, accepted, offered, verdict.ratios[single], verdict.p_value)
        members: Sequence[Candidate] = needed_changes(r, accepted, step.candidate)
        if step.candidate.shape.series:
            members = needed(r, accepted, members)
        steps = [replace(step, candidate=member) for member in members]
        two = None
        if step.candidate.beside is None:
            two = pair(r, accepted, verdict.candidates, verdict.ratios, step)
        if two is not None:
            first, second = two
            p_value = judged(fitted_model(r, [*accepted, first])).p_value
            if p_value <= level:
                beside = replace(step, candidate=second, rivals=(), p_value=p_value)
                steps = [replace(step, candidate=first, rivals=()), beside]
        entered = _reconsidered(r, candidates, [*found, *steps], len(known))
        entered = on_their_places(r, candidates, entered)
        if found and not tenable(r, [f.candidate for f in entered]):
            refused.add(step.candidate.label)
            continue
        found, dropped = parted(r, entered, len(known))
        refused.update(dropped)


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
        if not followed.issuperset(c.shape.beside):
            return False
        if c.label in once or not (c.follows is None or c.follows in present):
            return False
        return all(c.is_distinct(r, other) for other in accepted)

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
        ratios = screen.ratios(model.fitted.residuals[None])[0]
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
