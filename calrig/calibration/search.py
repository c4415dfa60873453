"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate
from calrig.calibration.gate import Verdict, gate
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import Fit, NoiseModel, fit, noise_of
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.ranking import Found, named, needed, pair
from calrig.calibration.responses import Responses
from calrig.calibration.run_changes import is_level, with_free_levels
from calrig.calibration.screen import Screen
from calrig.estimation.angles import FloatArray

LEVEL = 0.01
"""The nominal rate at which a search of noise alone says something."""
MOST_EFFECTS = 5
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
    too_small: set[str] = set()
    kept = np.arange(len(r))
    fewest = len(r) - most_outliers(len(r))

    def judged(accepted: Sequence[Candidate], fitted: Fit) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> FloatArray:
            return model_columns(r, [*accepted, *more])

        offered = _offered(candidates, accepted, too_small)
        return gate(r, columns_with, fitted, offered, rng, bootstraps, level, noise)

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
        if verdict.p_value > level or len(found) - len(known) >= MOST_EFFECTS:
            least = 1.0 / (bootstraps + 1)
            return Findings(r, kept, tuple(found), fitted, columns, verdict.p_value, least)
        step = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
        if _share_of_reading(r, accepted, step.candidate) < LEAST_SHARE:
            too_small.add(step.candidate.label)
            continue
        steps = [replace(step, candidate=member) for member in needed(r, accepted, step.candidate)]
        two = None
        if step.candidate.beside is None:
            two = pair(r, accepted, verdict.candidates, verdict.ratios, step)
        if two is not None:
            first, second = two
            p_value = judged([*accepted, first], fit(r, model_columns(r, [*accepted, first]))).p_value
            if p_value <= level:
                beside = replace(step, candidate=second, rivals=(), p_value=p_value)
                steps = [replace(step, candidate=first, rivals=()), beside]
        found = _reconsidered(r, candidates, [*found, *steps], len(known))


def _offered(
    candidates: Sequence[Candidate], accepted: Sequence[Candidate], too_small: set[str]
) -> list[Candidate]:
    """The candidates that may enter now: not those that have, nor those that follow on what has not."""
    present = {c.name for c in accepted}
    always = {c.name for c in accepted if c.changed is None}
    once = {c.label for c in accepted if c.named and not c.shape.at}

    def may_enter(c: Candidate) -> bool:
        if c.beside is not None:
            return not any(one.label in once or (one.name in always) for one in c.members)
        return c.label not in once and (c.effect.follows is None or c.effect.follows in present)

    return [c for c in candidates if c.label not in too_small and may_enter(c)]


def _reconsidered(
    r: Responses, candidates: Sequence[Candidate], found: list[Found], known: int
) -> list[Found]:
    """Each effect but the first known ones against its rivals once more, with all the others in the model."""
    if len(found) == known + 1:
        return found
    for place, one in list(enumerate(found))[known:]:
        others = [f.candidate for f in found if f is not one]
        offered = _offered(candidates, others, set())
        columns = model_columns(r, others)
        fitted = fit(r, columns)
        ratios = Screen(r, columns, offered, fitted.noise).ratios(fitted.residuals[None])[0]
        found[place] = named(r, others, offered, ratios, one.p_value)
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
