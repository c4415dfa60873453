"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.gate import Verdict, gate
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.ranking import Found, named, pair
from calrig.calibration.responses import Responses
from calrig.calibration.screen import Screen
from calrig.calibration.series import needed, on_their_places
from calrig.estimation.angles import FloatArray

LEVEL = 0.01
"""The nominal rate at which a search of noise alone says something."""
MOST_EFFECTS, MOST_COLUMNS = 5, 0.35
"""A series, such as the orders of a turn, is one effect of several terms; columns to a pose at most."""
LEAST_SHARE = 0.05
"""An effect whose part of the reading is smaller than this share of its noise is not worth a correction."""


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

    Args:
        r: the responses.
        candidates: of these poses (`candidates_of`).
        rng: of the gate's bootstrap.
        bootstraps: how many a step.
        level: of the gate.
    """
    found: list[Found] = []
    too_small: set[str] = set()
    kept = np.arange(len(r))
    fewest = len(r) - most_outliers(len(r))

    def judged(accepted: Sequence[Candidate], fitted: Fit) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> FloatArray:
            return model_columns(r, [*accepted, *more])

        offered = _offered(r, candidates, accepted, too_small)
        return gate(r, columns_with, fitted, offered, rng, bootstraps, level)

    while True:
        accepted = [f.candidate for f in found]
        columns = model_columns(r, accepted)
        fitted = fit(r, columns)
        verdict = judged(accepted, fitted)
        wild = outlier(r, accepted, fitted.criterion - verdict.gain) if len(kept) > fewest else None
        if wild is not None:
            others = np.delete(np.arange(len(r)), wild)
            kept, r, candidates = kept[others], r.rows(others), [c.rows(others) for c in candidates]
            found = [replace(f, candidate=f.candidate.rows(others)) for f in found]
            continue
        if verdict.p_value > level or _is_full(accepted):
            least = 1.0 / (bootstraps + 1)
            return Findings(r, kept, tuple(found), fitted, columns, verdict.p_value, least)
        step = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
        if _share_of_reading(r, accepted, step.candidate) < LEAST_SHARE:
            too_small.add(step.candidate.label)
            continue
        members: Sequence[Candidate] = step.candidate.members
        if step.candidate.shape.series:
            members = needed(r, accepted, members)
        steps = [replace(step, candidate=member) for member in members]
        two = None
        if len(steps) == 1:
            two = pair(r, accepted, verdict.candidates, verdict.ratios, step)
        if two is not None:
            first, second = two
            p_value = judged([*accepted, first], fit(r, model_columns(r, [*accepted, first]))).p_value
            if p_value <= level:
                beside = replace(step, candidate=second, rivals=(), p_value=p_value)
                steps = [replace(step, candidate=first, rivals=()), beside]
        found = on_their_places(r, candidates, _reconsidered(r, candidates, [*found, *steps]))


def _is_full(accepted: Sequence[Candidate]) -> bool:
    """Whether the model has as many effects as a run is searched for."""
    if not accepted:
        return False
    series = {c.shape.series for c in accepted if c.shape.series}
    alone = sum(not c.shape.series for c in accepted)
    columns = sum(c.columns.shape[2] for c in accepted)
    return len(series) + alone >= MOST_EFFECTS or columns > MOST_COLUMNS * len(accepted[0].columns)


def _offered(
    r: Responses, candidates: Sequence[Candidate], accepted: Sequence[Candidate], too_small: set[str]
) -> list[Candidate]:
    """The candidates that may enter now: not those that have, nor those that follow on what has not."""
    present = {c.name for c in accepted}
    once = {c.label for c in accepted if c.named and not c.shape.at}

    def may_enter(c: Candidate) -> bool:
        if c.beside is not None:
            return present.isdisjoint(member.name for member in c.members)
        if c.label in once or not (c.effect.follows is None or c.effect.follows in present):
            return False
        return all(c.effect.distinct(r, c.shape, other.shape) for other in accepted)

    return [c for c in candidates if c.label not in too_small and may_enter(c)]


def _reconsidered(r: Responses, candidates: Sequence[Candidate], found: list[Found]) -> list[Found]:
    """Each effect held against its rivals once more, with all the others in the model."""
    if len(found) == 1:
        return found
    for place, one in enumerate(found):
        others = [f.candidate for f in found if f is not one]
        offered = _offered(r, candidates, others, set())
        if one.candidate.shape.series:  # a curve takes a little from every term: the terms come first
            offered = [c for c in offered if c.named]
        columns = model_columns(r, others)
        fitted = fit(r, columns)
        ratios = Screen(r, columns, offered, fitted.noise).ratios(fitted.residuals[None])[0]
        found[place] = named(r, others, offered, ratios, one.p_value, one.candidate)
    return found


def _share_of_reading(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> float:
    """What a candidate adds to the reading, bias and scale taken off, over the reading's noise."""
    columns = model_columns(r, [*accepted, candidate])
    fitted = fit(r, columns)
    width = candidate.columns.shape[2]
    part = candidate.columns[:, 0, :] @ fitted.beta[-width:]
    line = np.column_stack([np.ones(len(r)), r.theta_deg])
    part = part - line @ np.linalg.lstsq(line, part, rcond=None)[0]
    return float(part.std() / np.hypot(fitted.residuals[:, 0].std(), r.rounding[0]))
