"""Fit candidate effects, linear and nonlinear, in addition to a model, and rank them.

The columns of the model are made orthonormal once for all candidates, those of a candidate once after them
(Frisch & Waugh, Econometrica 1, 1933); every further step weighs products of columns (`RepeatedSteps`). A
nonlinear parameter such as a period is refined by Gauss-Newton steps: the derivative of the model by it is
one more column, its coefficient the step and its variance the parameter's (Seber & Wild, Nonlinear
Regression, 1989, section 2.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
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
from calrig.calibration.diagnosis.sensor_model import (
    MOST_STEPS,
    NEGLIGIBLE,
    Curve,
    fitted_model,
    is_shift_seen,
)
from calrig.calibration.regression.effect import Parameters, Shape
from calrig.calibration.regression.noise_model import RepeatedSteps, fit, fits, orthonormal
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

NARROW = 2
"""Columns of most candidates: they are fitted as if all had so many, wider ones as if all had as many."""


class FitsBeside(NamedTuple):
    """Of k models: criterion (k,), coefficients (p,) each, the candidate's last, and residuals (k, n, J).

    With the variance (k,) of the last coefficient of each, where it was asked for.
    """

    criterion: FloatArray
    beta: list[FloatArray]
    residuals: FloatArray
    last_variance: FloatArray


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
    return CandidateFits(r, columns_with).of(candidates, [c.columns for c in candidates])


class CandidateFits:
    """Fits of candidates in addition to one model; what they have in common is made once.

    Args:
        r: the responses.
        columns_with: (n, J, p) columns of the model with some candidates beside it.
    """

    def __init__(self, r: Responses, columns_with: Callable[[Sequence[Candidate]], FloatArray]) -> None:
        self._r, self._columns_with = r, columns_with
        self._models: dict[str | None, _ModelFits] = {}

    def of(
        self, candidates: Sequence[Candidate], own: Sequence[FloatArray], *, with_variance: bool = False
    ) -> FitsBeside:
        """Fit the model with each of k candidates.

        Args:
            candidates: they say which column of the base they replace.
            own: (n, J, w) columns of each: the candidate's, or more.
            with_variance: whether the variance of the last coefficient is wanted.
        """
        count = len(candidates)
        residuals = np.empty((count, *self._r.values.shape))
        found = FitsBeside(np.empty(count), [np.empty(0)] * count, residuals, np.empty(count))
        alike: dict[str | None, list[int]] = {}
        for k, candidate in enumerate(candidates):
            alike.setdefault(candidate.shape.replaces, []).append(k)
        for replaces, those in alike.items():
            if replaces not in self._models:
                one = candidates[those[0]]
                model = self._columns_with([one])[:, :, : -one.columns.shape[2]]
                self._models[replaces] = _ModelFits(self._r, model)
            part = self._models[replaces].with_each([own[k] for k in those], with_variance=with_variance)
            found.criterion[those], found.residuals[those] = part.criterion, part.residuals
            found.last_variance[those] = part.last_variance
            for k, beta in zip(those, part.beta, strict=True):
                found.beta[k] = beta
        return found


class _ModelFits:
    """A model (n, J, q), to be fitted with columns in addition."""

    def __init__(self, r: Responses, model: FloatArray) -> None:
        self._r, self._width, (n, channels) = r, model.shape[2], r.values.shape
        spread = np.hypot(r.values.std(axis=0), r.rounding)
        self._weight = np.broadcast_to(1.0 / spread, (n, channels)).ravel()  # white to begin with
        rows = model.reshape(-1, self._width).T
        turn = _orthonormal_turn((rows * self._weight)[None])[0]
        base = turn.T @ rows
        there = np.any(base != 0.0, axis=1)
        self._base, self._turn = base[there], turn[:, there]
        values = r.values.ravel()
        self._first = self._base @ (values * self._weight**2)
        self._alone = values - self._first @ self._base
        self._further = RepeatedSteps(r, self._base)

    def with_each(self, candidates: Sequence[FloatArray], *, with_variance: bool) -> FitsBeside:
        """Fit the model with each of some columns (n, J, w)."""
        r, base, weight, (n, channels) = self._r, self._base, self._weight, self._r.values.shape
        values, known = r.values.ravel(), r.known.ravel()
        taken = max(1.0, (self._width + max(c.shape[2] for c in candidates)) / channels)
        count = len(candidates)
        residuals = np.empty((count, n, channels))
        found = FitsBeside(np.empty(count), [np.empty(0)] * count, residuals, np.full(count, np.nan))
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
            one_step = (self._alone - (along[:, None] @ beside)[:, 0]) * known
            steps = self._further.steps(one_step, beside, np.arange(len(those)), taken)
            found.criterion[those] = steps.products.criterion(*steps.products.noises(taken))
            found.residuals[those] = (steps.residuals * known).reshape(-1, n, channels)
            of_own = ((along + steps.more)[:, None] @ across)[:, 0]
            of_model = (self._first + steps.inside - (of_own[:, None] @ inside)[:, 0]) @ self._turn.T
            for place, k in enumerate(those):
                width = candidates[k].shape[2]
                found.beta[k] = np.concatenate([of_model[place], of_own[place, :width]])
                if with_variance:
                    last = np.concatenate([np.zeros(len(base)), across[place, :, width - 1]])
                    found.last_variance[k] = last @ np.linalg.solve(steps.gram[place], last)
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


class Refined(NamedTuple):
    """A candidate at its best place, with the criterion and its own coefficients (w,) there."""

    criterion: float
    own: FloatArray
    candidate: Candidate


class _Wanted(NamedTuple):
    """A candidate to fit in addition to the model, with columns (n, J, w) of its own."""

    candidate: Candidate
    columns: FloatArray
    with_variance: bool


class _Answer(NamedTuple):
    criterion: float
    own: FloatArray
    variance: float


_Refining = Generator[_Wanted, _Answer, Refined]


def refined(r: Responses, accepted: Sequence[Candidate], candidates: Sequence[Candidate]) -> list[Refined]:
    """Refine the nonlinear parameter (such as a period) of each of some candidates by maximum likelihood.

    All take their steps together, so that one call fits them all.

    Returns:
        Each by itself in addition to the accepted effects, with the parameter's standard error; a term of a
        series keeps its known parameter.
    """
    if not candidates:
        return []
    model = fitted_model(r, accepted)

    def columns_with(more: Sequence[Candidate]) -> FloatArray:
        return model_columns(model.responses, [*model.accepted, *more])

    fits_of = CandidateFits(model.responses, columns_with)
    refining = {k: _refining(model.responses, model.accepted, c) for k, c in enumerate(candidates)}
    wanted = {k: next(one) for k, one in refining.items()}
    found: dict[int, Refined] = {}
    while wanted:
        asked = list(wanted.values())
        with_variance = any(one.with_variance for one in asked)
        fitted = fits_of.of(
            [one.candidate for one in asked], [one.columns for one in asked], with_variance=with_variance
        )
        answers = zip(wanted.items(), fitted.criterion, fitted.beta, fitted.last_variance, strict=True)
        wanted = {}
        for (k, one), criterion, beta, variance in answers:
            own = beta[-one.columns.shape[2] :]
            try:
                wanted[k] = refining[k].send(_Answer(float(criterion), own, float(variance)))
            except StopIteration as done:
                found[k] = done.value
    return [found[k] for k in range(len(candidates))]


def _refining(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> _Refining:
    """Gauss-Newton steps of one candidate's place, each as long as it still improves the fit."""
    name = candidate.effect.place
    best = yield from _fitted_at(candidate)
    for _ in range(0 if candidate.shape.series else STEPS):
        step, std = yield from _step(r, best)
        place = best.candidate.shape.at[name]
        start = best
        while abs(step) > CLOSE * std and abs(step) < 0.5 * abs(place):
            moved = _moved(r, candidate, {**start.candidate.shape.at, name: place + step})
            trial = yield from _fitted_at(moved)
            is_better = trial.criterion < start.criterion and moved.effect.carried(r, moved.shape)
            if is_better and _is_distinct(r, accepted, moved):
                best = trial
                break
            step /= 4.0
        if best is start:
            break
    else:
        _, std = yield from _step(r, best)
    at = candidate.effect.settled(best.candidate.shape.at, {name: std})
    if at != best.candidate.shape.at:
        settled = _moved(r, candidate, at)
        if _is_distinct(r, accepted, settled):
            best = yield from _fitted_at(settled)
    here = best.candidate
    return best._replace(candidate=replace(here, shape=replace(here.shape, at_std={name: std})))


def _fitted_at(candidate: Candidate) -> _Refining:
    answer = yield _Wanted(candidate, candidate.columns, with_variance=False)
    return Refined(answer.criterion, answer.own, candidate)


def _step(r: Responses, one: Refined) -> Generator[_Wanted, _Answer, tuple[float, float]]:
    """By how much the place should move, and its standard error."""
    columns = np.concatenate([one.candidate.columns, slope(r, one.candidate, one.own)], axis=2)
    answer = yield _Wanted(one.candidate, columns, with_variance=True)
    return float(answer.own[-1]), math.sqrt(max(answer.variance, 0.0))


def _is_distinct(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> bool:
    return all(candidate.is_distinct(r, other) for other in accepted)


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
    columns = model_columns(seen, [*others, candidate])
    own = fit(seen, columns).beta[-candidate.columns.shape[2] :]
    moving = fit(seen, np.concatenate([columns, slope(seen, candidate, own)], axis=2))
    step, std = float(moving.beta[-1]), math.sqrt(max(float(moving.covariance[-1, -1]), 0.0))
    return abs(step) > BOUND * std and not is_carried(at[name] + step)


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

    def is_one_curve(self, r: Responses) -> bool:
        """Return whether all that it may be is one curve of the angle, the sensor's by a good reference.

        A rival at another period, or with a corner, is another curve between the poses.
        """
        those = (self.candidate, *self.rivals)
        is_smooth = all(c.is_smooth_of_sensor(r) for c in those)
        is_periodic = any(c.effect.place for c in self.rivals)
        return is_smooth and not is_periodic and not self.alike and self.candidate.changed is None

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
    first = [c for c in named if c.shape.claimed_first and named[0].name in c.shape.alike]
    claimed = (staying or first or named or near)[0]
    alike = () if is_shift_seen(r, accepted, claimed) else claimed.shape.alike
    rivals = _rivals(ranked, claimed, alike) if claimed.named else ()
    elsewhere: tuple[Candidate, ...] = ()
    if claimed.effect.place and claimed.beside is None:
        (claimed, *others), elsewhere = _alike(r, accepted, claimed)
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
    return SelectedEffect(claimed, rivals, p_value, float(lead), told, runners_up, alike=elsewhere)


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
    ranked: Sequence[tuple[float, Candidate]], claimed: Candidate, alike: Sequence[str]
) -> tuple[Candidate, ...]:
    """Return the best of each other name that is near or `alike`, and a nameless shape that leads."""
    best, leader = ranked[0]
    others: dict[str, Candidate] = {}
    for criterion, c in ranked:
        first = c.members[0]  # of two that only together explain it, the one that leads is the suspect
        # the claimed one, and another; what it is, whenever it came
        more = any(member.kind == claimed.kind for member in c.members)
        paid = COMPANION_MARGIN if len(c.members) > len(claimed.members) else 0.0
        near = criterion + paid - best < MARGIN or c.name in alike
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
    (best,) = refined(r, accepted, [claimed])
    found = [(best.criterion, best.candidate)]
    alike = [
        candidate_at(r, claimed, shape)
        for at in effect.look_alikes(r, best.candidate.shape)
        for shape in effect.forms(r, at)
    ]
    for criterion, own, other in refined(r, accepted, alike):
        others = [*accepted, *(c for _, c in found)]
        carried = _is_distinct(r, others, other) and effect.carried(r, other.shape)
        if carried and other.is_possible(own):
            found.append((criterion, other))
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
    moved = [k for k, c in enumerate(shortlist) if _has_place(c)]
    for k, one in zip(moved, refined(r, accepted, [shortlist[k] for k in moved]), strict=True):
        shortlist[k] = one.candidate
    if shortlist and moved[:1] != [0]:
        shortlist[0] = at_best_place(r, accepted, shortlist[0])
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


def _has_place(candidate: Candidate) -> bool:
    """Return whether the likelihood refines a place of a candidate."""
    return candidate.effect.place != "" and candidate.beside is None and not candidate.shape.series


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
