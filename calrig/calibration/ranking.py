"""The ranking: which candidate explains the poses best, and which others come too close to it to tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.candidates import Candidate, candidate_at
from calrig.calibration.curves_beside import fitted_beside
from calrig.calibration.effect import Shape
from calrig.calibration.places import refined
from calrig.calibration.responses import Responses
from calrig.calibration.screen import Float32Array, Screen
from calrig.calibration.sensor_model import fitted_model
from calrig.estimation.angles import FloatArray

MARGIN = 6.0
"""Of the criterion, between a name and the next: held by truth in 94–100 % where the data can decide."""
FAR_BEHIND = 40.0
"""So far behind, hardly any single pose brings a rival close; and odds would suggest too much precision."""
PAIR_MARGIN = 8.0
"""Of the criterion, by which two effects must beat the best one to enter together, and the second of them
must pass the gate beside the first: on trial by this margin alone it was wrong in 1 % of all runs.
"""
COMPANION_MARGIN = 3.0
"""Of the criterion, by which an effect must pay for the one companion that it is declared to have: with the
penalty a likelihood ratio beyond 7, which one parameter reaches in noise in less than 1 of 100. As a rival of
one effect alone it pays as much: that two bend each other straight is a coincidence.
"""
LEADING_NAMES = 4
SHORTLIST = 16
FARTHEST = 1e9
"""Of the criterion, where what physics rules out ranks."""
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
        considered: how far behind the best each label came.
        runners_up: the best candidate of each other name that came near enough for a pose to matter.
        doubts: why it is claimed no more than it is, in sentences.
        alike: the same effect at other places that explain these poses as well, likely or not.
    """

    candidate: Candidate
    rivals: tuple[Candidate, ...]
    p_value: float
    lead: float
    considered: tuple[tuple[str, float], ...] = ()
    runners_up: tuple[Candidate, ...] = ()
    doubts: tuple[str, ...] = ()
    alike: tuple[Candidate, ...] = ()

    @property
    def verdict(self) -> str:
        """`named`, `ambiguous` or `unnamed` (CONTRACT section 5)."""
        if not self.candidate.named:
            return "unnamed"
        return "ambiguous" if self.rivals else "named"

    def rows(self, chosen: npt.NDArray[np.intp]) -> Found:
        """The same in some of the poses."""
        candidate = self.candidate.rows(chosen)
        rivals, runners_up = (
            tuple(c.rows(chosen) for c in those) for those in (self.rivals, self.runners_up)
        )
        return replace(self, candidate=candidate, rivals=rivals, runners_up=runners_up)

    def against(self, rival: Candidate, doubt: str) -> Found:
        """With one rival more, and why."""
        return replace(self, rivals=(*self.rivals, rival), doubts=(*self.doubts, doubt))


def named(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: Float32Array,
    p_value: float,
    incumbent: Candidate | None = None,
) -> Found:
    """The best of the offered candidates by its full likelihood, and those that come too close to it.

    Of equals, a term of a series stays where it is already in the model: it came with the others.
    """
    ranked = _ranked(r, accepted, offered, ratios)
    best, leader = ranked[0]
    margin = MARGIN + (0.0 if leader.named else 2.0 * float(np.log(_forms(offered, leader.label))))
    near = [c for criterion, c in ranked if criterion - best < margin]
    named = [c for c in near if c.named]
    # A catalogue effect that explains as well outranks the flexible shapes that contain it.
    staying = [c for c in named if incumbent is not None and _is_same_term(c, incumbent)]
    claimed = (staying or named or near)[0]
    rivals = _rivals(ranked, claimed) if claimed.named else ()
    alike: tuple[Candidate, ...] = ()
    if claimed.effect.place and claimed.beside is None:
        (claimed, *others), alike = _alike(r, accepted, claimed)
        rivals = (*others, *rivals)
    own = min(criterion for criterion, c in ranked if c.label == claimed.label)
    rest = [criterion for criterion, c in ranked if c.kind != claimed.kind and c.named]
    lead = min(rest) - own if rest else np.inf
    considered: dict[str, float] = {}
    for criterion, c in ranked:
        if np.isfinite(criterion):  # what physics rules out was not considered
            considered.setdefault(c.label, round(max(criterion - best, 0.0), 2))
    runners_up = _runners_up(ranked, claimed)
    told = tuple(considered.items())
    return Found(claimed, rivals, p_value, float(lead), told, runners_up, alike=alike)


def _forms(offered: Sequence[Candidate], label: str) -> int:
    """How many forms something without a name has: the more, the better one of them fits by chance."""
    return len({c.shape.form for c in offered if c.label == label})


def _runners_up(ranked: Sequence[tuple[float, Candidate]], claimed: Candidate) -> tuple[Candidate, ...]:
    others: dict[str, Candidate] = {}
    for criterion, c in ranked:
        apart = c.named and c.beside is None and c.kind not in claimed.kind
        if apart and criterion - ranked[0][0] < FAR_BEHIND:
            others.setdefault(c.label, c)
    return tuple(others.values())


def _is_same_term(candidate: Candidate, other: Candidate) -> bool:
    return (
        candidate.shape.series != ""
        and candidate.label == other.label
        and candidate.shape.at == other.shape.at
    )


def _rivals(ranked: Sequence[tuple[float, Candidate]], claimed: Candidate) -> tuple[Candidate, ...]:
    """The best of each other name within `MARGIN` of the best, and a shape without a name that leads."""
    best, leader = ranked[0]
    others: dict[str, Candidate] = {}
    for criterion, c in ranked:
        first = c.members[0]  # of two that only together explain it, the one that leads is the suspect
        # the claimed one, and another; what it is, whenever it came
        more = any(member.kind == claimed.kind for member in c.members)
        paid = COMPANION_MARGIN if len(c.members) > len(claimed.members) else 0.0
        near = criterion + paid - best < MARGIN or c.name in claimed.shape.alike
        if c.named and not more and first.kind not in claimed.kind and near:
            others.setdefault(first.label, first)
    if not leader.named:
        others[leader.label] = leader
    return tuple(others.values())


def _alike(
    r: Responses, accepted: Sequence[Candidate], claimed: Candidate
) -> tuple[list[Candidate], tuple[Candidate, ...]]:
    """The claimed one at its best place with its rivals at others, and all that explain these poses as well.

    The largest of equals comes first: a long period before those that only the spacing makes of it. A place
    known beforehand, such as an order of the turn, is likelier than one among many by what a scan costs.
    """
    effect = claimed.effect
    best, own = refined(r, accepted, claimed)
    found = [(best.criterion, own)]
    for at in effect.look_alikes(r, own.shape):
        for shape in effect.forms(r, at):
            fitted, other = refined(r, accepted, candidate_at(r, claimed, shape))
            others = [*accepted, *(c for _, c in found)]
            apart = all(other.is_distinct(r, c) for c in others)
            if apart and other.is_possible(fitted.beta[-other.columns.shape[2] :]):
                found.append((fitted.criterion, other))
    least = min(criterion for criterion, _ in found)
    equal = [c for criterion, c in found if criterion - least < MARGIN]
    penalised = [(criterion + np.log(len(r)) * c.parameters, c) for criterion, c in found]
    likeliest = min(criterion for criterion, _ in penalised)
    near = [c for criterion, c in penalised if criterion - likeliest < MARGIN]
    near = sorted(near, key=lambda c: -c.shape.at[effect.place])
    return near, tuple(c for c in equal if c is not near[0])


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
        fitted = fitted_model(r, [*accepted, *added]).fitted
        return fitted.criterion + bic_penalty * sum(c.parameters for c in added)

    named = [i for i, c in enumerate(offered) if c.named and c.follows is None and c.beside is None]
    firsts: dict[str, Candidate] = {}
    for i in sorted(named, key=lambda i: bic_penalty * offered[i].parameters - float(ratios[i])):
        firsts.setdefault(offered[i].label, offered[i])
    to_beat = criterion(step.candidate) - dict(step.considered)[step.candidate.label] - PAIR_MARGIN
    best: tuple[Candidate, Candidate] | None = None
    for first in list(firsts.values())[:LEADING_NAMES]:
        model = fitted_model(r, [*accepted, first])
        rest = [offered[i] for i in named if offered[i].label != first.label]
        if not rest:
            continue
        screen = Screen(r, model.columns, rest, model.fitted.noise)
        more = screen.once(model.fitted.residuals)
        second = rest[_first_best(more - bic_penalty * np.array([c.parameters for c in rest]))]
        together = criterion(first, second)
        if together < to_beat - SAME:
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
    # what is not linear gains more than the screen can tell
    bent = [index for index in order[SHORTLIST:] if offered[index].effect.not_linear is not None]
    shortlist = [offered[index] for index in (*order[:SHORTLIST], *bent)]
    shortlist = [_refined(r, accepted, c, leads=k == 0) for k, c in enumerate(shortlist)]
    ranked = []
    for c, (criterion, own) in zip(shortlist, fitted_beside(r, accepted, shortlist), strict=True):
        penalised = criterion + bic_penalty * c.parameters
        ranked.append((penalised if c.is_possible(own) else np.inf, c))
    place = {candidate.label: k for k, candidate in reversed(list(enumerate(offered)))}
    return sorted(ranked, key=lambda pair: (round(min(pair[0], FARTHEST) / SAME), place[pair[1].label]))


def _first_best(values: FloatArray) -> int:
    """The first place whose value is the largest but for rounding."""
    return int(np.flatnonzero(values >= values.max() - SAME)[0])


def _refined(r: Responses, accepted: Sequence[Candidate], candidate: Candidate, *, leads: bool) -> Candidate:
    """A leading candidate at the best place between those scanned."""

    def of(shape: Shape) -> Candidate:
        return candidate_at(r, candidate, shape)

    def criterion(shape: Shape) -> float:
        return fitted_model(r, [*accepted, of(shape)]).fitted.criterion

    if candidate.effect.place and candidate.beside is None and not candidate.shape.series:
        return refined(r, accepted, candidate)[1]
    refine = candidate.effect.refine if leads and candidate.beside is None else None
    finer = refine and refine(r, candidate.shape, criterion)
    return candidate if finer is None else of(finer)
