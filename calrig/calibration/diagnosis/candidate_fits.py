"""Fit candidate effects, linear and nonlinear, in addition to a model, and rank them.

The columns of the model are made orthonormal once for all candidates, those of a candidate once after them
(Frisch & Waugh, Econometrica 1, 1933); every further step weighs products of columns (`RepeatedSteps`). A
nonlinear parameter such as a period is refined by Gauss-Newton steps: the derivative of the model by it is
one more column, its coefficient the step and its variance the parameter's (Seber & Wild, Nonlinear
Regression, 1989, section 2.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    candidate_at,
    goes_round,
    model_columns,
    side_by_side,
)
from calrig.calibration.diagnosis.screen import Float32Array, Screen
from calrig.calibration.diagnosis.sensor_model import MOST_STEPS, NEGLIGIBLE, Curve, fitted_model
from calrig.calibration.regression.effect import Parameters, Shape
from calrig.calibration.regression.noise_model import Fit, RepeatedSteps, fit, fits, orthonormal
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

NARROW = 2
"""Columns of most candidates: they are fitted as if all had so many, wider ones as if all had as many."""


class FitsBeside(NamedTuple):
    """Of k models: criterion (k,), coefficients (p,) each, the candidate's last, and residuals (k, n, J)."""

    criterion: FloatArray
    beta: list[FloatArray]
    residuals: FloatArray


def fit_candidates(
    r: Responses,
    columns_with: Callable[[Sequence[Candidate]], FloatArray],
    candidates: Sequence[Candidate],
) -> FitsBeside:
    """Fit a model with each candidate added to it.

    Args:
        r: the responses.
        columns_with: (n, J, p) columns of the model with some candidates beside it.
        candidates: those.
    """
    count = len(candidates)
    found = FitsBeside(np.empty(count), [np.empty(0)] * count, np.empty((count, *r.values.shape)))
    alike: dict[str | None, list[int]] = {}
    for k, candidate in enumerate(candidates):
        alike.setdefault(candidate.shape.replaces, []).append(k)
    for those in alike.values():
        own = [candidates[k].columns for k in those]
        model = columns_with([candidates[those[0]]])[:, :, : -own[0].shape[2]]
        part = _fits_beside(r, model, own)
        found.criterion[those], found.residuals[those] = part.criterion, part.residuals
        for k, beta in zip(those, part.beta, strict=True):
            found.beta[k] = beta
    return found


def _fits_beside(r: Responses, model: FloatArray, candidates: Sequence[FloatArray]) -> FitsBeside:
    """Of columns (n, J, w) each beside a model (n, J, q)."""
    q, (n, channels) = model.shape[2], r.values.shape
    spread = np.hypot(r.values.std(axis=0), r.rounding)
    weight = np.broadcast_to(1.0 / spread, (n, channels)).ravel()  # white to begin with
    rows = model.reshape(-1, q).T
    turn = _orthonormal_turn((rows * weight)[None])[0]
    base = turn.T @ rows
    there = np.any(base != 0.0, axis=1)
    base, turn = base[there], turn[:, there]
    values = r.values.ravel()
    first = base @ (values * weight**2)
    alone = values - first @ base
    further = RepeatedSteps(r, base)
    taken = max(1.0, (q + max(c.shape[2] for c in candidates)) / channels)
    count = len(candidates)
    found = FitsBeside(np.empty(count), [np.empty(0)] * count, np.empty((count, n, channels)))
    narrow = [k for k, candidate in enumerate(candidates) if candidate.shape[2] <= NARROW]
    wide = [k for k, candidate in enumerate(candidates) if candidate.shape[2] > NARROW]
    for those in filter(None, (narrow, wide)):
        own = np.zeros((len(those), max(candidates[k].shape[2] for k in those), values.size))
        for place, k in enumerate(those):
            own[place, : candidates[k].shape[2]] = candidates[k].reshape(values.size, -1).T
        inside = own @ (base * weight**2).T
        left = own - inside @ base
        across = np.swapaxes(_orthonormal_turn(left * weight, own * weight), 1, 2)
        beside = across @ left
        along = beside @ (values * weight**2)
        residuals = (alone - (along[:, None] @ beside)[:, 0]) * r.known.ravel()
        steps = further.steps(residuals, beside, np.arange(len(those)), taken)
        found.criterion[those] = steps.products.criterion(*steps.products.noises(taken))
        found.residuals[those] = (steps.residuals * r.known.ravel()).reshape(-1, n, channels)
        of_own = ((along + steps.more)[:, None] @ across)[:, 0]
        of_model = (first + steps.inside - (of_own[:, None] @ inside)[:, 0]) @ turn.T
        for place, k in enumerate(those):
            found.beta[k] = np.concatenate([of_model[place], of_own[place, : candidates[k].shape[2]]])
    return found


def _orthonormal_turn(rows: FloatArray, before: FloatArray | None = None) -> FloatArray:
    """(k, w, w) what makes columns, in rows (k, w, n·J), orthonormal; `before` others were taken off them."""
    size = np.linalg.norm(rows if before is None else before, axis=2)
    return orthonormal(rows @ np.swapaxes(rows, 1, 2), size)


LEFT_BEHIND = 60.0
"""Of the criterion: so far behind, a fit that bends by the noise stays linear: it is worth 12 at most."""


def fitted_beside(
    r: Responses, accepted: Sequence[Candidate], shortlist: Sequence[Candidate]
) -> list[tuple[float, FloatArray]]:
    """Return criterion and own coefficients of each of several candidates beside the accepted effects.

    All are fitted at once, linear about what is accepted; once more, and again, those that bend.
    """
    at = fitted_model(r, accepted)
    curves = [Curve(r, [*accepted, candidate]) for candidate in shortlist]
    penalties = [float(np.log(len(r))) * candidate.parameters for candidate in shortlist]

    def columns_with(more: Sequence[Candidate]) -> FloatArray:
        return model_columns(at.responses, [*at.accepted, *more])

    straight = fit_candidates(at.responses, columns_with, shortlist)
    fitted = list(zip(straight.criterion.tolist(), straight.beta, straight.residuals, strict=True))
    found = [(criterion, beta) for criterion, beta, _ in fitted]
    bent = list(range(len(shortlist)))
    for step in range(1 + MOST_STEPS):
        if step > 0:
            fitted = _fitted_straightened(r, [curves[k].straightened(found[k][1]) for k in bent])
        for k, (criterion, beta, _) in zip(bent, fitted, strict=True):
            found[k] = criterion, beta[: curves[k].width]
        least = min(criterion + penalty for (criterion, _), penalty in zip(found, penalties, strict=True))
        bent = [
            k
            for k, (criterion, _, residuals) in zip(bent, fitted, strict=True)
            if _bends_yet(curves[k], found[k][1], residuals, criterion + penalties[k] - least)
        ]
        if not bent:
            break
    for k in bent:  # it does not come to rest: the linear fit
        linear = fit(r, model_columns(r, [*accepted, shortlist[k]]))
        found[k] = linear.criterion, linear.beta
    return [(criterion, beta[curve.own[-1]]) for (criterion, beta), curve in zip(found, curves, strict=True)]


def _fitted_straightened(
    r: Responses, steps: Sequence[tuple[Responses, Sequence[Candidate]]]
) -> list[tuple[float, FloatArray, FloatArray]]:
    """Criterion, coefficients (≥ p,) and residuals (n, J) of several linear models, each of its responses."""
    values = np.stack([straight.values for straight, _ in steps])
    fitted = fits(r, values, side_by_side([model_columns(*step) for step in steps]))
    return list(zip(fitted.criterion.tolist(), fitted.beta, fitted.residuals, strict=True))


def _bends_yet(curve: Curve, beta: FloatArray, residuals: FloatArray, behind: float) -> bool:
    """Return whether a linear fit (p,), with residuals (n, J), is worth another about its coefficients.

    Not one so far behind the best, in its penalised criterion, that bending so little does not matter.
    """
    if not curve.bends:
        return False
    by = curve.bent_by(beta, residuals)
    return by >= NEGLIGIBLE and behind < LEFT_BEHIND * max(by, 1.0) and curve.is_possible(beta)


STEPS = 5
BOUND = 2.0
"""Standard errors of the place, from a bound: there it is looked at where the likelihood would have it."""
CLOSE = 0.05
"""Standard errors of the place: a smaller step changes nothing."""
NUDGE = 1e-5
"""Of a place, to either side: its slope by difference."""


def slope(r: Responses, candidate: Candidate, beta: FloatArray) -> FloatArray:
    """Return (n, J, 1) change of what a candidate adds with its effect's place, at coefficients beta (p,)."""
    name, at = candidate.effect.place, candidate.shape.at
    nudge = NUDGE * abs(at[name])
    above, below = (_moved(r, candidate, {**at, name: at[name] + side}) for side in (nudge, -nudge))
    change = (above.columns - below.columns) @ beta / (2.0 * nudge)
    return np.asarray(change[:, :, None], dtype=np.float64)


def refined(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> tuple[Fit, Candidate]:
    """Refine the nonlinear parameter of a candidate (such as a period) by maximum likelihood.

    Returns:
        The fit of the model with it, and the candidate with the parameter's standard error; a term of a
        series keeps its known parameter.
    """
    name = candidate.effect.place
    model = fitted_model(r, accepted)
    r, accepted = model.responses, model.accepted
    fitted = fit(r, model_columns(r, [*accepted, candidate]))
    for _ in range(0 if candidate.shape.series else STEPS):
        step, std = _step(r, accepted, candidate, fitted)
        place = candidate.shape.at[name]
        moved, better = candidate, fitted
        while abs(step) > CLOSE * std and abs(step) < 0.5 * abs(place):
            moved = _moved(r, candidate, {**candidate.shape.at, name: place + step})
            better = fit(r, model_columns(r, [*accepted, moved]))
            is_better = better.criterion < fitted.criterion and moved.effect.carried(r, moved.shape)
            if is_better and _is_distinct(r, accepted, moved):
                break
            step /= 4.0
            moved, better = candidate, fitted
        if moved is candidate:
            break
        candidate, fitted = moved, better
    _, std = _step(r, accepted, candidate, fitted)
    return _settled(r, accepted, candidate, fitted, {name: std})


def _is_distinct(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> bool:
    return all(candidate.is_distinct(r, other) for other in accepted)


def _step(
    r: Responses, accepted: Sequence[Candidate], candidate: Candidate, fitted: Fit
) -> tuple[float, float]:
    """By how much the place should move, and its standard error."""
    own = fitted.beta[-candidate.columns.shape[2] :]
    columns = np.concatenate(
        [model_columns(r, [*accepted, candidate]), slope(r, candidate, own)],
        axis=2,
    )
    moving = fit(r, columns)
    return float(moving.beta[-1]), math.sqrt(max(float(moving.covariance[-1, -1]), 0.0))


def _is_at_bound(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> bool:
    """Return whether a place that was scanned for lies at a bound because the poses carry no better one."""
    name, at = candidate.effect.place, candidate.shape.at
    near = BOUND * candidate.shape.at_std.get(name, 0.0) if candidate.shape.scanned else 0.0

    def is_carried(place: float) -> bool:
        return candidate.effect.carried(r, replace(candidate.shape, at={**at, name: place}))

    if near == 0.0 or near >= at[name] or (is_carried(at[name] - near) and is_carried(at[name] + near)):
        return False
    model = fitted_model(r, accepted)
    seen, others = model.responses, model.accepted
    step, std = _step(seen, others, candidate, fit(seen, model_columns(seen, [*others, candidate])))
    return abs(step) > BOUND * std and not is_carried(at[name] + step)


def _settled(
    r: Responses, accepted: Sequence[Candidate], candidate: Candidate, fitted: Fit, std: Parameters
) -> tuple[Fit, Candidate]:
    at = candidate.effect.settled(candidate.shape.at, std)
    settled = candidate if at == candidate.shape.at else _moved(r, candidate, at)
    if settled is not candidate and _is_distinct(r, accepted, settled):
        candidate = settled
        fitted = fit(r, model_columns(r, [*accepted, candidate]))
    return fitted, replace(candidate, shape=replace(candidate.shape, at_std=std))


def _moved(r: Responses, candidate: Candidate, at: Parameters) -> Candidate:
    """Return the same form at another place."""
    (shape,) = candidate.effect.forms(r, at)
    return candidate_at(r, candidate, shape)


MARGIN = 6.0
"""Of the criterion, between a name and the next: held by truth in 94–100 % where the data can decide."""
FAR_BEHIND = 40.0
"""So far behind, hardly any single pose brings a rival close; and odds would suggest too much precision."""
PAIR_MARGIN = 8.0
"""Of the criterion, by which two effects must beat the best one to enter together, and the second of them
must pass the gate beside the first: on trial by this margin alone it was wrong in 1 % of all runs.
"""
INDISTINCT = 0.5
"""Of −2 log likelihood: periods that evenly spaced poses cannot tell apart at all, whatever the noise."""
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

    def rows(self, chosen: npt.NDArray[np.intp]) -> SelectedEffect:
        """Return the same in some of the poses."""
        candidate = self.candidate.rows(chosen)
        rivals, runners_up = (
            tuple(c.rows(chosen) for c in those) for those in (self.rivals, self.runners_up)
        )
        return replace(self, candidate=candidate, rivals=rivals, runners_up=runners_up)

    def against(self, rival: Candidate, doubt: str) -> SelectedEffect:
        """With one rival more, and why."""
        return replace(self, rivals=(*self.rivals, rival), doubts=(*self.doubts, doubt))


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
    claimed = (staying or named or near)[0]
    rivals = _rivals(ranked, claimed) if claimed.named else ()
    alike: tuple[Candidate, ...] = ()
    if claimed.effect.place and claimed.beside is None:
        (claimed, *others), alike = _alike(r, accepted, claimed)
        rivals = (*others, *rivals)
    own = min(criterion for criterion, c in ranked if c.label == claimed.label)
    rest = [criterion for criterion, c in ranked if c.kind != claimed.kind and c.named]
    lead = min(rest) - own if rest and np.isfinite(own) else np.inf
    considered: dict[str, float] = {}
    for criterion, c in ranked:
        if np.isfinite(criterion):  # what physics rules out was not considered
            considered.setdefault(c.label, round(max(criterion - best, 0.0), 2))
    runners_up = _runners_up(ranked, claimed)
    told = tuple(considered.items())
    return SelectedEffect(claimed, rivals, p_value, float(lead), told, runners_up, alike=alike)


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

    A known one of equals comes first, then the largest: a long period before those that only the spacing
    makes of it. A place known beforehand, such as an order of the turn, is likelier than one among many by
    what a scan costs.
    """
    effect = claimed.effect
    best, own = refined(r, accepted, claimed)
    found = [(best.criterion, own)]
    for at in effect.look_alikes(r, own.shape):
        for shape in effect.forms(r, at):
            fitted, other = refined(r, accepted, candidate_at(r, claimed, shape))
            others = [*accepted, *(c for _, c in found)]
            apart = all(other.is_distinct(r, c) for c in others)
            carried = apart and effect.carried(r, other.shape)
            if carried and other.is_possible(fitted.beta[-other.columns.shape[2] :]):
                found.append((fitted.criterion, other))
    least = min(criterion for criterion, _ in found)
    equal = [c for criterion, c in found if criterion - least < MARGIN]
    penalised = [(criterion + np.log(len(r)) * c.parameters, c) for criterion, c in found]
    likeliest = min(criterion for criterion, _ in penalised)
    likely = {c for criterion, c in penalised if criterion - likeliest < MARGIN}
    if not goes_round(r):  # there an order of the turn is no likelier than what is the same thing
        likely.update(c for criterion, c in found if criterion - least < INDISTINCT)
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
    shortlist = [_refined(r, accepted, c, leads=k == 0) for k, c in enumerate(shortlist)]
    ranked = []
    for c, (criterion, own) in zip(shortlist, fitted_beside(r, accepted, shortlist), strict=True):
        penalised = criterion + bic_penalty * c.parameters
        may_be = c.is_possible(own) and not _is_at_bound(r, accepted, c)
        ranked.append((penalised if may_be else np.inf, c))
    place = {candidate.label: k for k, candidate in reversed(list(enumerate(offered)))}
    return sorted(ranked, key=lambda pair: (round(min(pair[0], FARTHEST) / SAME), place[pair[1].label]))


def _first_best(values: FloatArray) -> int:
    """Return the first place whose value is the largest but for rounding."""
    return int(np.flatnonzero(values >= values.max() - SAME)[0])


def _refined(r: Responses, accepted: Sequence[Candidate], candidate: Candidate, *, leads: bool) -> Candidate:
    """Return a leading candidate at the best place between those scanned."""

    def of(shape: Shape) -> Candidate:
        return candidate_at(r, candidate, shape)

    def criterion(shape: Shape) -> float:
        return fitted_model(r, [*accepted, of(shape)]).fitted.criterion

    if candidate.effect.place and candidate.beside is None and not candidate.shape.series:
        return refined(r, accepted, candidate)[1]
    refine = candidate.effect.refine if leads and candidate.beside is None else None
    finer = refine and refine(r, candidate.shape, criterion)
    return candidate if finer is None else of(finer)
