"""Fit candidate effects, linear and nonlinear, in addition to a model.

The columns of the model are made orthonormal once for all candidates, those of a candidate once after them
(Frisch & Waugh, Econometrica 1, 1933); every further step weighs products of columns (`RepeatedSteps`). A
nonlinear parameter such as a period is refined by Gauss-Newton steps: the derivative of the model by it is
one more column, its coefficient the step and its variance the parameter's (Seber & Wild, Nonlinear
Regression, 1989, section 2.1).
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    candidate_at,
    distinct_from,
    model_columns,
    side_by_side,
)
from calrig.calibration.diagnosis.sensor_model import (
    MOST_STEPS,
    NEGLIGIBLE,
    Curve,
    fitted_model,
)
from calrig.calibration.regression.effect import Parameters
from calrig.calibration.regression.noise_model import RepeatedSteps, fit, fits, orthonormal, solved
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import THE_TURN
from calrig.estimation.angles import FloatArray

WIDTHS = (2, 5, 9, 17)
"""Columns: candidates of at most so many, and of more than the next lower number, are fitted as if all had as
many."""


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

    `columns_with` gives the (n, J, p) columns of the model with some candidates beside it.
    """
    return CandidateFits(r, columns_with).of(candidates, [c.columns for c in candidates])


class CandidateFits:
    """Fits of candidates in addition to one model; what they have in common is made once.

    `columns_with` gives the (n, J, p) columns of the model with some candidates beside it.
    """

    def __init__(self, r: Responses, columns_with: Callable[[Sequence[Candidate]], FloatArray]) -> None:
        self._r, self._columns_with = r, columns_with
        self._models: dict[str | None, _ModelFits] = {}

    def of(
        self, candidates: Sequence[Candidate], own: Sequence[FloatArray], *, with_variance: bool = False
    ) -> FitsBeside:
        """Fit the model with each of k candidates, which say what column of the base they replace.

        `own` are (n, J, w) columns of each: the candidate's, or more. `with_variance` asks for the variance
        of the last coefficient.
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
        alike: dict[int, list[int]] = {}
        for k, candidate in enumerate(candidates):
            alike.setdefault(bisect_left(WIDTHS, candidate.shape[2]), []).append(k)
        for those in alike.values():
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
                    found.last_variance[k] = last @ solved(steps.gram[place], last)
        return found


def _orthonormal_turn(rows: FloatArray, before: FloatArray | None = None) -> FloatArray:
    """(k, w, w) what makes columns, in rows (k, w, n·J), orthonormal; `before` others were taken off them."""
    size = np.linalg.norm(rows if before is None else before, axis=2)
    return orthonormal(rows @ np.swapaxes(rows, 1, 2), size)


LEFT_BEHIND = 60.0
"""Of the criterion: so far behind, a fit that bends by the noise stays linear: it is worth 12 at most."""
KEPT = 4
"""Models whose candidates may be asked for again: after one of them has been refused, all others are."""


@dataclass(slots=True)
class _BesideModel:
    """A candidate's fit in addition to a model, as far as it has come.

    Attributes:
        curve: of the model with it.
        criterion, beta: of the last fit.
        bent_by: of a channel's residuals, how far these are from those of the curve; 0 of one at rest.
        steps: fits so far.
    """

    curve: Curve
    criterion: float
    beta: FloatArray
    bent_by: float = math.inf
    steps: int = 0

    def take(self, criterion: float, beta: FloatArray, residuals: FloatArray) -> None:
        """Take the next fit, with residuals (n, J)."""
        self.criterion, self.beta = criterion, beta[: self.curve.width]
        self.bent_by = self.curve.bent_by(self.beta, residuals) if self.curve.bends else 0.0
        self.steps += 1

    def bends_yet(self, behind: float) -> bool:
        """Return whether it is worth another fit about its coefficients.

        Not one so far behind the best, in its penalised criterion, that bending so little does not matter.
        """
        by = self.bent_by
        return by >= NEGLIGIBLE and behind < LEFT_BEHIND * max(by, 1.0) and self.curve.is_possible(self.beta)


class _Model:
    """What has been fitted in addition to a model."""

    def __init__(self, r: Responses, accepted: tuple[Candidate, ...]) -> None:
        at = self.at = fitted_model(r, accepted)
        self.fits = CandidateFits(at.responses, at.columns_with)
        self.beside: dict[Candidate, _BesideModel] = {}
        self.refined: dict[Candidate, Refined] = {}


@lru_cache(maxsize=KEPT)
def _model(r: Responses, accepted: tuple[Candidate, ...]) -> _Model:
    return _Model(r, accepted)


def fitted_beside(
    r: Responses, accepted: Sequence[Candidate], shortlist: Sequence[Candidate]
) -> list[tuple[float, FloatArray]]:
    """Return criterion and own coefficients of each of several candidates beside the accepted effects.

    All are fitted at once, linear about what is accepted; once more, and again, those that bend.
    """
    model = _model(r, tuple(accepted))
    new = [candidate for candidate in shortlist if candidate not in model.beside]
    if new:
        fitted = model.fits.of(new, [candidate.columns for candidate in new])
        for c, *answer in zip(new, fitted.criterion.tolist(), fitted.beta, fitted.residuals, strict=True):
            model.beside[c] = one = _BesideModel(Curve(r, [*accepted, c]), 0.0, np.empty(0))
            one.take(*answer)
    penalties = [float(np.log(len(r))) * candidate.parameters for candidate in shortlist]
    found = [model.beside[candidate] for candidate in shortlist]
    while True:
        penalised = [one.criterion + penalty for one, penalty in zip(found, penalties, strict=True)]
        # linear, a delay leaves what it does to the effects that it moves: it is not behind yet
        behind = [
            0.0 if is_delay(c) else criterion - min(penalised)
            for c, criterion in zip(shortlist, penalised, strict=True)
        ]
        bent = [k for k, one in enumerate(found) if one.bends_yet(behind[k])]
        stepping = [found[k] for k in bent if found[k].steps <= MOST_STEPS]
        if not stepping:
            break
        steps = [one.curve.straightened(one.beta) for one in stepping]
        for one, again in zip(stepping, _fitted_straightened(r, steps), strict=True):
            one.take(*again)
    for k in bent:  # it does not come to rest: the linear fit
        linear = fit(r, model_columns(r, [*accepted, shortlist[k]]))
        found[k].criterion, found[k].beta, found[k].bent_by = linear.criterion, linear.beta, 0.0
    return [(one.criterion, one.beta[one.curve.own[-1]]) for one in found]


def is_delay(candidate: Candidate) -> bool:
    """Return whether a candidate is a delay, or has one among its members."""
    return any(member.effect.late_by_deg is not None for member in candidate.members)


def _fitted_straightened(
    r: Responses, steps: Sequence[tuple[Responses, Sequence[Candidate]]]
) -> list[tuple[float, FloatArray, FloatArray]]:
    """Criterion, coefficients (≥ p,) and residuals (n, J) of several linear models, each of its responses."""
    values = np.stack([straight.values for straight, _ in steps])
    fitted = fits(r, values, side_by_side([model_columns(*step) for step in steps]))
    return list(zip(fitted.criterion.tolist(), fitted.beta, fitted.residuals, strict=True))


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
    above, below = (moved(r, candidate, {**at, name: at[name] + side}) for side in (nudge, -nudge))
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
    beside = _model(r, tuple(accepted))
    model, found = beside.at, beside.refined
    refining = {c: _refining(model.responses, model.accepted, c) for c in candidates if c not in found}
    wanted = {c: next(one) for c, one in refining.items()}
    while wanted:
        asked = list(wanted.values())
        with_variance = any(one.with_variance for one in asked)
        fitted = beside.fits.of(
            [one.candidate for one in asked], [one.columns for one in asked], with_variance=with_variance
        )
        answers = zip(wanted.items(), fitted.criterion, fitted.beta, fitted.last_variance, strict=True)
        wanted = {}
        for (c, one), criterion, beta, variance in answers:
            own = beta[-one.columns.shape[2] :]
            try:
                wanted[c] = refining[c].send(_Answer(float(criterion), own, float(variance)))
            except StopIteration as done:
                found[c] = done.value
    return [found[c] for c in candidates]


def _refining(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> _Refining:
    """Gauss-Newton steps of one candidate's place, each as long as it still improves the fit."""
    name, is_distinct = candidate.effect.place, distinct_from(r, accepted)
    best = yield from _fitted_at(candidate)
    for _ in range(0 if candidate.shape.series else STEPS):
        step, std = yield from _step(r, best)
        place = best.candidate.shape.at[name]
        start = best
        while abs(step) > CLOSE * std and abs(step) < 0.5 * abs(place):
            there = moved(r, candidate, {**start.candidate.shape.at, name: place + step})
            trial = yield from _fitted_at(there)
            is_better = trial.criterion < start.criterion and there.effect.carried(r, there.shape)
            if is_better and is_distinct(there):
                best = trial
                break
            step /= 4.0
        if best is start:
            break
    else:
        _, std = yield from _step(r, best)
    at = candidate.effect.settled(best.candidate.shape.at, {name: std})
    if at != best.candidate.shape.at:
        settled = moved(r, candidate, at)
        if is_distinct(settled):
            best = yield from _fitted_at(settled)
    here = best.candidate
    is_known = here.shape.series == THE_TURN and not here.shape.scanned
    at_std = {} if is_known else {name: std}
    return best._replace(candidate=replace(here, shape=replace(here.shape, at_std=at_std)))


def _fitted_at(candidate: Candidate) -> _Refining:
    answer = yield _Wanted(candidate, candidate.columns, with_variance=False)
    return Refined(answer.criterion, answer.own, candidate)


def _step(r: Responses, one: Refined) -> Generator[_Wanted, _Answer, tuple[float, float]]:
    """By how much the place should move, and its standard error."""
    columns = np.concatenate([one.candidate.columns, slope(r, one.candidate, one.own)], axis=2)
    answer = yield _Wanted(one.candidate, columns, with_variance=True)
    return float(answer.own[-1]), math.sqrt(max(answer.variance, 0.0))


def is_at_bound(r: Responses, accepted: Sequence[Candidate], candidate: Candidate) -> bool:
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


def moved(r: Responses, candidate: Candidate, at: Parameters) -> Candidate:
    """Return the same form at another place."""
    (shape,) = candidate.effect.forms(r, at)
    return candidate_at(r, candidate, shape)
