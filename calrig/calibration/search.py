"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.candidates import Candidate, base_without, candidate_of
from calrig.calibration.effect import Shape
from calrig.calibration.gate import Screen, Verdict, gate
from calrig.calibration.noise_model import Fit, fit
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

LEVEL = 0.01
"""The nominal rate at which a search of noise alone says something."""
MARGIN = 6.0
"""Of the criterion, between a name and the next: held by truth in 94–100 % where the data can decide."""
PAIR_MARGIN = 8.0
"""Of the criterion, by which two effects must beat the best one to enter together, and the second of them
must pass the gate beside the first: on trial by this margin alone it was wrong in 1 % of all runs.
"""
LEADING_NAMES = 4
MOST_EFFECTS = 5
SHORTLIST = 16
LEAST_SHARE = 0.05
"""An effect whose part of the reading is smaller than this share of its noise is not worth a correction."""
SAME = 1e-3
"""Of −2 log likelihood: the screen's single precision decides no more, and the first of equals is taken."""


@dataclass(frozen=True, slots=True)
class Found:
    """An effect that the gate let through.

    Attributes:
        candidate: the form that explains it best.
        rivals: candidates of other names that these data cannot tell from it.
        p_value: of the search that found it, as a whole.
        lead: how much worse the best candidate of another name is, in −2 log likelihood with penalties;
            negative where a rival explains it better.
    """

    candidate: Candidate
    rivals: tuple[Candidate, ...]
    p_value: float
    lead: float
    considered: tuple[tuple[str, float], ...] = ()

    @property
    def verdict(self) -> str:
        """`named`, `ambiguous` or `unnamed` (CONTRACT section 5)."""
        if not self.candidate.named:
            return "unnamed"
        return "ambiguous" if self.rivals else "named"


@dataclass(frozen=True, slots=True)
class Findings:
    """What a search found, and the fit of the model it arrived at."""

    found: tuple[Found, ...]
    fitted: Fit
    columns: FloatArray
    p_value_left: float
    least_p_value: float
    """What the bootstrap could have told at best."""


def model_columns(r: Responses, accepted: Sequence[Candidate]) -> FloatArray:
    """(n, J, p) columns of bias and scale, then of the accepted candidates in their order."""
    replaced = next((c.shape.replaces for c in accepted if c.shape.replaces), None)
    return np.concatenate([base_without(r, replaced), *[c.columns for c in accepted]], axis=2)


def own_columns(columns: FloatArray, accepted: Sequence[Candidate]) -> list[slice]:
    """Where each accepted candidate's own columns lie among those of `model_columns`."""
    ends = np.cumsum([c.columns.shape[2] for c in accepted])
    base = columns.shape[2] - int(ends[-1]) if accepted else 0
    return [
        slice(base + int(end) - c.columns.shape[2], base + int(end))
        for c, end in zip(accepted, ends, strict=True)
    ]


def search(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    *,
    bootstraps: int,
    level: float = LEVEL,
) -> Findings:
    """Finds the effects in some poses.

    Args:
        r: the responses.
        candidates: of these poses (`candidates_of`).
        rng: of the gate's bootstrap.
        bootstraps: how many a step.
        level: of the gate.
    """
    found: list[Found] = []
    too_small: set[str] = set()

    def judged(accepted: Sequence[Candidate]) -> tuple[FloatArray, Fit, Verdict]:
        columns = model_columns(r, accepted)
        fitted = fit(r, columns)
        offered = _offered(candidates, accepted, too_small)
        return columns, fitted, gate(r, columns, fitted, offered, rng, bootstraps)

    while True:
        accepted = [f.candidate for f in found]
        columns, fitted, verdict = judged(accepted)
        step, verdict = _step(r, accepted, verdict, level, too_small)
        if step is None or len(found) >= MOST_EFFECTS:
            return Findings(tuple(found), fitted, columns, verdict.p_value, 1.0 / (bootstraps + 1))
        steps = [step]
        if pair := _pair(r, accepted, verdict, step):
            first, second = pair
            p_value = judged([*accepted, first])[2].p_value
            if p_value <= level:
                beside = replace(step, candidate=second, rivals=(), p_value=p_value)
                steps = [replace(step, candidate=first, rivals=()), beside]
        found = _reconsidered(r, candidates, [*found, *steps])


def _step(
    r: Responses, accepted: Sequence[Candidate], verdict: Verdict, level: float, too_small: set[str]
) -> tuple[Found | None, Verdict]:
    """The effect that enters next, and the verdict that lets it, less what is too small to be worth it."""
    while verdict.p_value <= level:
        step = _named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
        if _share_of_reading(r, accepted, step.candidate) >= LEAST_SHARE:
            return step, verdict
        too_small.add(step.candidate.label)
        verdict = verdict.without(step.candidate.label)
    return None, verdict


def _offered(
    candidates: Sequence[Candidate], accepted: Sequence[Candidate], too_small: set[str]
) -> list[Candidate]:
    """The candidates that may enter now: not those that have, nor those that follow on what has not."""
    present = {c.name for c in accepted}
    once = {c.label for c in accepted if c.named and not c.shape.at}
    return [
        c
        for c in candidates
        if c.label not in too_small
        and c.label not in once
        and (c.effect.follows is None or c.effect.follows in present)
    ]


def _named(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: np.ndarray[tuple[int], np.dtype[np.float32]],
    p_value: float,
) -> Found:
    """The best of the offered candidates by its full likelihood, and those that come too close to it."""
    ranked = _ranked(r, accepted, offered, ratios)
    best = ranked[0][0]
    near = [c for criterion, c in ranked if criterion - best < MARGIN]
    named = [c for c in near if c.named]
    # A catalogue effect that explains as well outranks the flexible shapes that contain it.
    claimed = (named or near)[0]
    rivals = _rivals(ranked, claimed) if claimed.named else ()
    own = min(criterion for criterion, c in ranked if c.label == claimed.label)
    rest = [criterion for criterion, c in ranked if c.label != claimed.label and c.named]
    lead = min(rest) - own if rest else np.inf
    considered: dict[str, float] = {}
    for criterion, c in ranked:
        considered.setdefault(c.label, round(max(criterion - best, 0.0), 2))
    return Found(claimed, rivals, p_value, float(lead), tuple(considered.items()))


def _rivals(ranked: Sequence[tuple[float, Candidate]], claimed: Candidate) -> tuple[Candidate, ...]:
    """The best of each other name within `MARGIN` of the best, and a shape without a name that leads."""
    best, leader = ranked[0]
    others: dict[str, Candidate] = {}
    for criterion, c in ranked:
        if c.named and c.label != claimed.label and criterion - best < MARGIN:
            others.setdefault(c.label, c)
    if not leader.named:
        others[leader.label] = leader
    return tuple(others.values())


def _pair(
    r: Responses, accepted: Sequence[Candidate], verdict: Verdict, step: Found
) -> tuple[Candidate, Candidate] | None:
    """Two named effects that together explain far more than the best one does, None where there are none.

    What both come with time hide each other: a slip in a drift looks like correlated noise once the wrong one
    of them, or a curve that is neither, has entered alone.
    """
    bic_penalty = float(np.log(len(r)))
    offered, ratios = verdict.candidates, verdict.ratios

    def criterion(*added: Candidate) -> float:
        fitted = fit(r, model_columns(r, [*accepted, *added]))
        return fitted.criterion + bic_penalty * sum(c.parameters for c in added)

    named = [i for i, c in enumerate(offered) if c.named and c.effect.follows is None]
    firsts: dict[str, Candidate] = {}
    for i in sorted(named, key=lambda i: bic_penalty * offered[i].parameters - float(ratios[i])):
        firsts.setdefault(offered[i].label, offered[i])
    to_beat = criterion(step.candidate) - dict(step.considered)[step.candidate.label] - PAIR_MARGIN
    best: tuple[Candidate, Candidate] | None = None
    for first in list(firsts.values())[:LEADING_NAMES]:
        columns = model_columns(r, [*accepted, first])
        rest = [offered[i] for i in named if offered[i].label != first.label]
        if not rest:
            continue
        fitted = fit(r, columns)
        more = Screen(r, columns, rest, fitted.noise).ratios(fitted.residuals[None])[0]
        second = rest[_first_best(more - bic_penalty * np.array([c.parameters for c in rest]))]
        together = criterion(first, second)
        if together < to_beat:
            to_beat, best = together, (first, second)
    return best


def _ranked(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: np.ndarray[tuple[int], np.dtype[np.float32]],
) -> list[tuple[float, Candidate]]:
    """A shortlist, the best of each form, ordered by −2 log likelihood plus log n for each parameter."""
    bic_penalty = float(np.log(len(r)))
    best: dict[tuple[str, str], int] = {}
    for index, candidate in enumerate(offered):
        key = candidate.label, candidate.shape.form
        if key not in best or ratios[index] > ratios[best[key]] + SAME:
            best[key] = index
    order = sorted(best.values(), key=lambda i: bic_penalty * offered[i].parameters - float(ratios[i]))
    ranked: list[tuple[float, Candidate]] = []
    for index in order[:SHORTLIST]:
        criterion, candidate = _refined(r, accepted, offered[index], len(ranked) == 0)
        ranked.append((criterion + bic_penalty * candidate.parameters, candidate))
    place = {candidate.label: k for k, candidate in reversed(list(enumerate(offered)))}
    return sorted(ranked, key=lambda pair: (round(pair[0] / SAME), place[pair[1].label]))


def _first_best(values: FloatArray) -> int:
    """The first place whose value is the largest but for rounding."""
    return int(np.flatnonzero(values >= values.max() - SAME)[0])


def _refined(
    r: Responses, accepted: Sequence[Candidate], candidate: Candidate, leads: bool
) -> tuple[float, Candidate]:
    """The criterion of a candidate; of a leading one, at the best place between those scanned."""

    def criterion(shape: Shape) -> float:
        return fit(r, model_columns(r, [*accepted, candidate_of(r, candidate.effect, shape)])).criterion

    refine = candidate.effect.refine
    if refine is None or not leads:
        return fit(r, model_columns(r, [*accepted, candidate])).criterion, candidate
    finer = refine(r, candidate.shape, criterion)
    return criterion(finer), candidate_of(r, candidate.effect, finer)


def _reconsidered(r: Responses, candidates: Sequence[Candidate], found: list[Found]) -> list[Found]:
    """Each effect held against its rivals once more, with all the others in the model."""
    if len(found) == 1:
        return found
    for place, one in enumerate(found):
        others = [f.candidate for f in found if f is not one]
        offered = _offered(candidates, others, set())
        columns = model_columns(r, others)
        fitted = fit(r, columns)
        ratios = Screen(r, columns, offered, fitted.noise).ratios(fitted.residuals[None])[0]
        found[place] = _named(r, others, offered, ratios, one.p_value)
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
