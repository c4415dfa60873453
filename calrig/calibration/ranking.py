"""The ranking: which candidate explains the poses best, and which others come too close to it to tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.candidates import Candidate, candidate_of
from calrig.calibration.effect import Shape
from calrig.calibration.model import model_columns
from calrig.calibration.noise_model import fit
from calrig.calibration.responses import Responses
from calrig.calibration.run_changes import RUN, changed_shapes
from calrig.calibration.screen import Float32Array, Screen
from calrig.estimation.angles import FloatArray

MARGIN = 6.0
"""Of the criterion, between a name and the next: held by truth in 94–100 % where the data can decide."""
PAIR_MARGIN = 8.0
"""Of the criterion, by which two effects must beat the best one to enter together, and the second of them
must pass the gate beside the first: on trial by this margin alone it was wrong in 1 % of all runs.
"""
LEADING_NAMES = 4
SHORTLIST = 16
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


def named(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: Float32Array,
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
    rest = [criterion for criterion, c in ranked if c.kind != claimed.kind and c.named]
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
        first = c.members[0]  # of two that only together explain it, the one that leads is the suspect
        if c.named and first.kind not in claimed.kind and criterion - best < MARGIN:
            others.setdefault(first.label, first)
    if not leader.named:
        others[leader.label] = leader
    return tuple(others.values())


def needed(r: Responses, accepted: Sequence[Candidate], together: Candidate) -> list[Candidate]:
    """The members of a candidate, of several changes between runs those that are worth a parameter each."""
    members = list(together.members)
    bic_penalty = float(np.log(len(r)))

    def criterion(kept: Sequence[Candidate]) -> float:
        return fit(r, model_columns(r, [*accepted, *kept])).criterion + bic_penalty * len(kept)

    while len(members) > 1 and together.effect.covariate is RUN:
        fewer = min(([m for m in members if m is not one] for one in members), key=criterion)
        if criterion(fewer) > criterion(members):
            break
        members = fewer
    return members


def pair(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: Float32Array,
    step: Found,
) -> tuple[Candidate, Candidate] | None:
    """Two named effects that together explain far more than the best one does, None where there are none.

    What both come with time hide each other: a slip in a drift looks like correlated noise once the wrong one
    of them, or a curve that is neither, has entered alone.
    """
    bic_penalty = float(np.log(len(r)))

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
    ratios: Float32Array,
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

    def of(shape: Shape) -> Candidate:
        (here,) = changed_shapes(r, candidate.changed, [shape])
        return candidate_of(r, candidate.effect, here)

    def criterion(shape: Shape) -> float:
        return fit(r, model_columns(r, [*accepted, of(shape)])).criterion

    refine = candidate.effect.refine if leads and candidate.beside is None else None
    finer = refine and refine(r, candidate.shape, criterion)
    if finer is not None:
        candidate = of(finer)
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    own = fitted.beta[-candidate.columns.shape[2] :]
    return fitted.criterion if candidate.is_possible(own) else np.inf, candidate
