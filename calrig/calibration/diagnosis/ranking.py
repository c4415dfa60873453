"""Rank the candidates of a step: the name claimed, its rivals, and what these poses cannot tell from it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import Self

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidate_fits import (
    fitted_beside,
    is_at_bound,
    is_delay,
    refined,
)
from calrig.calibration.diagnosis.candidates import (
    Candidate,
    at_its_elevations,
    candidate_at,
    distinct_from,
)
from calrig.calibration.diagnosis.screen import Float32Array, Screen
from calrig.calibration.diagnosis.sensor_model import (
    fitted_model,
    is_shift_seen,
)
from calrig.calibration.effects.backlash import YIELDING
from calrig.calibration.effects.stage_periodic import spacing_deg, turns_back
from calrig.calibration.regression.effect import Shape
from calrig.calibration.regression.noise_model import Fit
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import goes_round
from calrig.estimation.angles import FloatArray

MARGIN = 6.0
"""Of the criterion, between a name and the next: held by truth in 94–100 % where the data can decide."""
FAR_BEHIND = 40.0
"""So far behind, hardly any single pose brings a rival close; and odds would suggest too much precision."""
PAIR_MARGIN = 8.0
"""Of the criterion, by which two effects must beat the best one to enter together, and the second of them
must pass the gate beside the first: on trial by this margin alone it was wrong in 1 % of all runs.
"""
CONTAINED = "the other curves of the angle contain it: together they are one curve"
"""A doubt of the name alone."""
EQUAL = 0.01
"""Of −2 log likelihood: what differs by less is the same thing, if it has other parameters."""
INDISTINCT = 0.5
"""Of −2 log likelihood: periods that evenly spaced poses cannot tell apart at all, whatever the noise."""
ALIAS_SHARE = 0.6
"""Of what the best of several aliases gains, beside a delay that alone tells them apart: a rival gains it."""
COMPANION_MARGIN = 3.0
"""Of the criterion, by which an effect must pay for the one companion that it is declared to have: with the
penalty a likelihood ratio beyond 7, which one parameter reaches in noise in less than 1 of 100. As a rival of
one effect alone it pays as much: that two bend each other straight is a coincidence.
"""
MOST_OF_A_LEAD = 0.5
"""Of a lead, what must be left without a pose: every pose has some part in it."""
DECISIVE = 2
"""Poses that speak loudest for a name against a rival, each left out in turn: the others decide less."""
LEADING_NAMES = 4
SHORTLIST = 16
FARTHEST = 1e9
"""Of the criterion, where what physics rules out ranks."""
SURPASSED_SHARE = 0.6
"""Of the best gain on the screen, what a candidate reaches that may have the best likelihood: a place between
two scanned ones gains a quarter more at most, and the screen, which has the null's noise, misses no tenth."""
POSES_A_WAVE = 4.0
"""Or more, for poses to follow a wave from one to the next, and not an alias of it."""
SAME = 1e-3
"""Of −2 log likelihood: the screen's single precision decides no more, and the first of equals is taken."""


@dataclass(frozen=True, slots=True)
class SelectedEffect:
    """An effect that passed the significance test.

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

    def is_one_curve(self, r: Responses, found: Iterable[Self]) -> bool:
        """Return whether all that it may be is one curve of the angle, the sensor's by a good reference.

        With the other effects `found`, its rivals leave the same residuals but for less than these are, or
        those contain it, and the sum of all is what corrects. The same holds between the poses: none has a
        corner, and the poses follow every wave among them.
        """
        others = [f.candidate for f in found if f is not self]
        beside = [(c.label, c.shape.at) for c in others]  # a rival that is there as well is no other curve
        those = [self.candidate, *(c for c in self.rivals if (c.label, c.shape.at) not in beside)]
        if self.candidate.changed is not None or not all(c.is_smooth_of_sensor(r) for c in those):
            return False
        periods_deg = [c.shape.at[place] for c in those if (place := c.effect.place)]
        if min(periods_deg, default=np.inf) < POSES_A_WAVE * np.diff(np.unique(r.theta_deg)).max(initial=0.0):
            return False
        if CONTAINED in self.doubts:
            return True
        left = [fitted_model(r, [*others, c]).fitted.residuals[:, 0] for c in those]
        return all(np.std(one - left[0]) <= np.std(left[0]) for one in left)

    def rows(self, chosen: npt.NDArray[np.intp]) -> Self:
        """Return the same in some of the poses."""
        return self._with_each(lambda candidate: candidate.rows(chosen))

    def at_elevations_of(self, r: Responses) -> Self:
        """With columns at the elevations of these poses, where a delay made them at earlier ones."""
        return self._with_each(partial(at_its_elevations, r))

    def _with_each(self, changed: Callable[[Candidate], Candidate]) -> Self:
        rivals, runners_up, alike = (
            tuple(map(changed, those)) for those in (self.rivals, self.runners_up, self.alike)
        )
        return replace(
            self, candidate=changed(self.candidate), rivals=rivals, runners_up=runners_up, alike=alike
        )

    def against(self, rival: Candidate, doubt: str) -> Self:
        """With one rival more, and why."""
        return replace(self, rivals=(*self.rivals, rival), doubts=(*self.doubts, doubt))


def within_reach(
    r: Responses, offered: Sequence[Candidate], ratios: Float32Array
) -> tuple[list[Candidate], Float32Array]:
    """Return the candidates that may be the best by their full likelihood, and their ratios on the screen."""
    penalised = ratios - float(np.log(len(r))) * np.array([c.parameters for c in offered])
    those = penalised >= SURPASSED_SHARE * penalised.max() - MARGIN
    # what is not linear, or moves others, gains more than the screen can tell
    those |= np.array([c.effect.not_linear is not None or is_delay(c) for c in offered])
    return list(compress(offered, those)), ratios[those]


def named(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: Float32Array,
    p_value: float,
    incumbent: Candidate | None = None,
) -> SelectedEffect:
    """Return the best of the offered candidates by its full likelihood, and those that come too close to it.

    Of equals, a term of a series stays where it is already in the model: it came with the others. Nothing is
    `considered` where physics rules all of them out.
    """
    ranked = _ranked(r, accepted, offered, ratios)
    best, leader = ranked[0]
    margin = MARGIN + (0.0 if leader.named else 2.0 * float(np.log(_forms(offered, leader.label))))
    near = [c for criterion, c in ranked if criterion == best or criterion - best < margin]
    named = [c for c in near if c.named]
    # A catalogue effect that explains as well outranks the flexible shapes that contain it.
    staying = [c for c in named if incumbent is not None and _is_same_term(c, incumbent)]
    first = [c for c in named if c.shape.claimed_first and named[0].name in c.shape.alike]
    claimed = (staying or first or named or near)[0]
    alike = claimed.shape.alike
    if alike and {"latency", "backlash"}.issuperset(alike) and is_shift_seen(r, accepted, claimed):
        alike = ()
    rivals = _rivals(ranked, claimed, alike, float(np.log(len(r)))) if claimed.named else ()
    elsewhere: tuple[Candidate, ...] = ()
    if claimed.effect.place and claimed.beside is None:
        (claimed, *others), elsewhere = _alike(r, accepted, claimed)
        rivals = (*others, *rivals)
    own = min(criterion for criterion, c in ranked if c.label == claimed.label)
    kinds = {m.kind for m in claimed.members}
    rest = [one for one, c in ranked if c.named and not kinds.issubset(m.kind for m in c.members)]
    lead = min(rest) - own if rest and np.isfinite(own) else np.inf
    considered: dict[str, float] = {}
    for criterion, c in ranked:
        if np.isfinite(criterion):  # what physics rules out was not considered
            considered.setdefault(c.label, round(max(criterion - best, 0.0), 2))
    runners_up = _runners_up(ranked, claimed)
    behind = tuple(considered.items())
    return SelectedEffect(claimed, rivals, p_value, float(lead), behind, runners_up, alike=elsewhere)


def _forms(offered: Sequence[Candidate], label: str) -> int:
    """Return how many forms something without a name has: the more, the better one of them fits by chance."""
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


def _rivals(
    ranked: Sequence[tuple[float, Candidate]], claimed: Candidate, alike: Sequence[str], bic_penalty: float
) -> tuple[Candidate, ...]:
    """Return the best of each other name that is near or `alike`, and a nameless shape that leads.

    Near is one of the same column that fits as well to the last digit, too, however many parameters it has:
    it is the same thing in these poses.
    """
    best, leader = ranked[0]
    same = [one for one in ranked if (one[1].label, one[1].shape.form) == (claimed.label, claimed.shape.form)]
    own, its = min((one - bic_penalty * c.parameters for one, c in same), default=np.inf), claimed.covariate
    others: dict[str, Candidate] = {}
    for criterion, c in ranked:
        first = c.members[0]  # of two that only together explain it, the one that leads is the suspect
        # the claimed one, and another; what it is, whenever it came
        more = any(member.kind == claimed.kind for member in c.members)
        paid = COMPANION_MARGIN if len(c.members) > len(claimed.members) else 0.0
        is_same = c.covariate == its and abs(criterion - bic_penalty * c.parameters - own) < EQUAL
        near = criterion + paid - best < MARGIN or c.name in alike or is_same
        if c.named and not more and first.kind not in claimed.kind and near:
            others.setdefault(first.label, first)
    if not leader.named and all(member.kind != claimed.kind for member in leader.members):
        others[leader.label] = leader
    return tuple(others.values())


def _alike(
    r: Responses, accepted: Sequence[Candidate], claimed: Candidate
) -> tuple[list[Candidate], tuple[Candidate, ...]]:
    """The claimed one at its best place with its rivals at others, and all that explain these poses as well.

    A known one of equals comes first, then the largest: a long period before those that only the spacing
    makes of it. A place known beforehand, such as an order of the turn, is likelier than one among many by
    what a scan costs.
    """
    effect = claimed.effect
    (best,) = refined(r, accepted, [claimed])
    found = [(best.criterion, best.candidate)]
    alike = [
        candidate_at(r, claimed, shape)
        for at in effect.look_alikes(r, best.candidate.shape)
        for shape in effect.forms(r, at)
    ]
    is_distinct = distinct_from(r, accepted)
    for criterion, own, other in refined(r, accepted, alike):
        carried = is_distinct(other) and effect.carried(r, other.shape)
        # an alias that turns the readings back fits these poses as well, and makes no sense
        is_odd = turns_back(other.shape, own) and not turns_back(best.candidate.shape, best.own)
        if carried and other.is_possible(own) and not is_odd:
            found.append((criterion, other))
    least = min(criterion for criterion, _ in found)
    equal = [c for criterion, c in found if criterion - least < MARGIN]
    penalised = [(criterion + np.log(len(r)) * c.parameters, c) for criterion, c in found]
    likeliest, winner = min(penalised, key=lambda one: one[0])
    likely = {c for criterion, c in penalised if criterion - likeliest < MARGIN}
    if not goes_round(r):  # there an order of the turn is no likelier than what is the same thing
        likely.update(c for criterion, c in found if criterion - least < INDISTINCT)
    model = fitted_model(r, accepted)
    is_parted_by_delay = model.responses.is_delayed and spacing_deg(r.theta_deg) is not None
    if is_parted_by_delay and least < best.criterion - MARGIN:
        # an alias won that was not scanned for: two waves together look like one at another place
        most = model.fitted.criterion - ALIAS_SHARE * (model.fitted.criterion - least)
        likely.update(c for criterion, c in found if criterion <= most)
    for criterion, other in penalised:  # nor may one pose alone, off an even spacing, tell places apart
        is_near = other not in likely and criterion - likeliest < FAR_BEHIND
        if is_near and decisive_pose(r, accepted, winner, other) is not None:
            likely.add(other)
    near = [c for _, c in found if c in likely]
    near = sorted(near, key=lambda c: (c.shape.scanned, -c.shape.at[effect.place]))
    return near, tuple(c for c in equal if c is not near[0])


def pair(
    r: Responses,
    accepted: Sequence[Candidate],
    offered: Sequence[Candidate],
    ratios: Float32Array,
    step: SelectedEffect,
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
    moved = [k for k, c in enumerate(shortlist) if _has_place(c)]
    for k, one in zip(moved, refined(r, accepted, [shortlist[k] for k in moved]), strict=True):
        shortlist[k] = one.candidate
    gains = [float(ratios[i]) - bic_penalty * offered[i].parameters for i in order[:SHORTLIST]]
    for k, gain in enumerate(gains):
        # at the nearest place scanned a kink, or a yield, may be far behind, and the best where it really is
        is_coarse = not shortlist[k].named or shortlist[k].shape.form == YIELDING
        may_lead = is_coarse and gain > max(SURPASSED_SHARE * gains[0], 0.0)
        if (k == 0 or may_lead) and k not in moved:
            shortlist[k] = at_best_place(r, accepted, shortlist[k])
    ranked = []
    for c, (criterion, own) in zip(shortlist, fitted_beside(r, accepted, shortlist), strict=True):
        penalised = criterion + bic_penalty * c.parameters
        may_be = c.is_possible(own) and not is_at_bound(r, accepted, c)
        ranked.append((penalised if may_be else np.inf, c))
    place = {candidate.label: k for k, candidate in reversed(list(enumerate(offered)))}
    return sorted(ranked, key=lambda pair: (round(min(pair[0], FARTHEST) / SAME), place[pair[1].label]))


def _first_best(values: FloatArray) -> int:
    """Return the first place whose value is the largest but for rounding."""
    return int(np.flatnonzero(values >= values.max() - SAME)[0])


def _has_place(candidate: Candidate) -> bool:
    """Return whether the likelihood refines a place of a candidate."""
    return candidate.effect.place != "" and candidate.beside is None and not candidate.shape.series


def candidates_in(found: Iterable[SelectedEffect]) -> list[Candidate]:
    """Return the candidates that effects were selected from."""
    return [f.candidate for f in found]


def at_best_place(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> Candidate:
    """Return a candidate at the best place between those scanned."""

    def of(shape: Shape) -> Candidate:
        return candidate_at(r, candidate, shape)

    def criterion(shape: Shape) -> float:
        return fitted_model(r, [*accepted, of(shape)]).fitted.criterion

    if _has_place(candidate):
        return refined(r, accepted, [candidate])[0].candidate
    refine = None if candidate.beside is not None else candidate.effect.refine
    finer = refine and refine(r, candidate.shape, criterion)
    return candidate if finer is None else of(finer)


def decisive_pose(
    r: Responses, others: Sequence[Candidate], claimed: Candidate, runner_up: Candidate
) -> int | None:
    """The pose that holds most of the lead, and without which it is less than `MARGIN`; None without one."""
    both = [[*others, claimed], [*others, runner_up]]
    ours, theirs = (fitted_model(r, effects).fitted for effects in both)
    penalty = float(np.log(len(r))) * (runner_up.parameters - claimed.parameters)
    lead = theirs.criterion - ours.criterion + penalty
    for pose in np.argsort(-_for_the_claim(r, ours, theirs), kind="stable")[:DECISIVE]:
        rest = np.delete(np.arange(len(r)), pose)
        seen = r.rows(rest)
        left = [fitted_model(seen, [c.rows(rest) for c in effects]).fitted for effects in both]
        if left[1].criterion - left[0].criterion + penalty < min(MARGIN, MOST_OF_A_LEAD * lead):
            return int(pose)
    return None


def _for_the_claim(r: Responses, ours: Fit, theirs: Fit) -> npt.NDArray[np.float64]:
    """(n,) by how much each pose's innovations are larger, in −2 log likelihood, under the rival's fit."""
    own, rival = (ours.noise.whiten(f.residuals, r.starts) ** 2 for f in (ours, theirs))
    variance = own.mean(axis=0)
    gained = np.divide(rival - own, variance, out=np.zeros_like(own), where=variance > 0.0)
    return np.asarray(gained.sum(axis=1), dtype=np.float64)
