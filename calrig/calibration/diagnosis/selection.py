"""Select effects forward, reconsider them, and eliminate them backward.

Terms of a series, such as the orders of a turn or changes from run to run: which of them a model needs.

Rivals that came near an effect in all poses: a fold, which repeats the search, asks of no others again.

Only where an effect that has entered is held against its rivals once more: what enters is judged, and named,
among all candidates.

Whether an effect is worth a name: what it does to the reading, and how sure that is.

What enters a model: the best alone, with a companion, or two effects that hide each other.

Effects that have entered, held against their rivals once more, with all the others in the model.

The model as a whole, after an effect has entered: what cannot be, and what is not needed any more.

Forward steps alone keep what once helped: two curves of 222° and 243° that cancel, an offset of 2.8 g against
an eccentricity, a cycle of time that the angle has explained since.

Outliers: a pose so far from what the model says of it that no effect and no noise explains it.

A pose is judged against the model and what the other poses leave of it, not by its neighbours: a slip moves
all poses after it, an error of angle all near it, and at the ends of a range or where the sense of motion
changes the neighbours lie on one side (Chen & Liu, Journal of the American Statistical Association 88, 1993,
who part outliers from level shifts by one likelihood).

Poses revisited from one side: what they differ by is no function of the elevation, whatever that may be.

An axis' error may be wavy all along and differ by direction. Half explained it looks like noise that wanders,
and hides what steps or drifts beside it; with a free curve for each side in the base that shows by itself.

The search: effects enter one by one while the gate lets one through, each is held against its rivals.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import permutations
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidate_fits import COMPANION_MARGIN, MARGIN, SelectedEffect, named, pair
from calrig.calibration.diagnosis.candidates import (
    Candidate,
    companions_of,
    goes_round,
    model_columns,
    own_columns,
)
from calrig.calibration.diagnosis.lack_of_fit import SEVERAL
from calrig.calibration.diagnosis.screen import Screen
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.diagnosis.significance_test import (
    ModelKey,
    Noises,
    NullGains,
    Verdict,
    gate,
    model_of,
)
from calrig.calibration.effects.unnamed import MORE_KNOTS, POSES_A_KNOT, TIMES, natural_spline
from calrig.calibration.regression.channels import ANGLE, READING
from calrig.calibration.regression.effect import APPROACH, ELEVATION, HIDDEN, Parameters
from calrig.calibration.regression.noise_model import STRONG_RHO, Fit, NoiseModel, fit, noise_of, stacked
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.run_changes import RUN, is_level, with_free_levels
from calrig.estimation.angles import FloatArray, robust_std


def needed(r: Responses, accepted: Sequence[Candidate], terms: Sequence[Candidate]) -> list[Candidate]:
    """Those of some terms that pay for themselves beside the others."""
    kept = list(terms)
    while len(kept) > 1:
        whole = _criterion_of_model(r, [*accepted, *kept])
        without = [
            _criterion_of_model(r, [*accepted, *kept[:k], *kept[k + 1 :]]) - whole for k in range(len(kept))
        ]
        least = int(np.argmin(without))
        if without[least] >= MARGIN:
            break
        del kept[least]
    return kept


def needed_changes(r: Responses, accepted: Sequence[Candidate], together: Candidate) -> list[Candidate]:
    """The members of a candidate, of several changes between runs those that are worth a parameter each."""
    members = list(together.members)
    bic_penalty = float(np.log(len(r)))

    def criterion(kept: Sequence[Candidate]) -> float:
        return fitted_model(r, [*accepted, *kept]).fitted.criterion + bic_penalty * len(kept)

    while len(members) > 1 and together.effect.covariate is RUN:
        fewer = min(([m for m in members if m is not one] for one in members), key=criterion)
        if criterion(fewer) > criterion(members):
            break
        members = fewer
    return members


def on_their_places(
    r: Responses, candidates: Sequence[Candidate], found: list[SelectedEffect]
) -> list[SelectedEffect]:
    """Effects at scanned places put on the known ones beside them, where the model is the better for it.

    Found one after the other, each was refined while others were missing: all are tried at once, then each.
    """
    known = [c for c in candidates if c.shape.series and not c.shape.scanned and c.beside is None]
    moves = {k: place for k, f in enumerate(found) if (place := _beside(r, f.candidate, known)) is not None}
    for some in (list(moves), *([k] for k in moves)) if moves else ():
        put = [
            replace(f, candidate=moves[k]) if k in some and f.candidate is not moves[k] else f
            for k, f in enumerate(found)
        ]
        before, after = ([f.candidate for f in each] for each in (found, put))
        if _criterion_of_model(r, after) < _criterion_of_model(r, before):
            found = put
    return found


def _beside(r: Responses, candidate: Candidate, known: Sequence[Candidate]) -> Candidate | None:
    """The known place that these poses do not resolve from a candidate's, the nearest."""
    name = candidate.effect.place
    if not name or candidate.shape.series:
        return None
    alike = [c for c in known if c.label == candidate.label and not c.is_distinct(r, candidate)]
    return min(alike, key=lambda c: abs(c.shape.at[name] - candidate.shape.at[name]), default=None)


def _criterion_of_model(r: Responses, model: Sequence[Candidate]) -> float:
    """−2 log likelihood plus log n for each parameter."""
    parameters = sum(c.parameters for c in model)
    return fitted_model(r, model).fitted.criterion + float(np.log(len(r))) * parameters


HOPELESS = 80.0
"""Of the criterion, behind an effect in all poses: with a quarter of them left out it is some 60 behind."""
Rivals = Mapping[str, Collection[str]]
"""Labels by that of the effect."""


def competing_candidates(found: Sequence[SelectedEffect]) -> Rivals:
    """Of each effect found, the labels that are not hopeless against it.

    Among them all others that were found, alone and two as one: it may stand in for them until they enter.
    """
    labels = [f.candidate.label for f in found]
    every = {*labels, *(" + ".join(two) for two in permutations(labels, 2))}
    return {
        f.candidate.label: every.union(label for label, behind in f.considered if behind < HOPELESS)
        for f in found
    }


def near_among(
    candidates: Sequence[Candidate], one: SelectedEffect, rivals: Rivals | None
) -> Sequence[Candidate]:
    """The candidates that are not known to be hopeless against an effect."""
    near = None if rivals is None else rivals.get(one.candidate.label)
    return candidates if near is None else [c for c in candidates if c.label in near]


LEAST_SHARE = 0.05
"""An effect whose part of the reading is smaller than this share of its noise is not worth a correction."""
LEAST_STANDARD_ERRORS = 4.0
"""Of the parameters that reach the reading, together: what a witness alone shows is not named."""
LEAST_OF_A_COMPANION = 3.0
"""The same of one of the two or three effects declared to come with what is in the model: noise gives
one of three so many standard errors in 0.8 %, one of a hundred candidates four in 0.6 %.
"""


def is_practically_significant(r: Responses, accepted: Sequence[Candidate], step: SelectedEffect) -> bool:
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
    least = LEAST_OF_A_COMPANION if candidate.label in companions_of(accepted) else LEAST_STANDARD_ERRORS
    helps = step.verdict != "named" or left_deg <= left_before_deg
    return part.std() >= LEAST_SHARE * left_deg and sure >= least and helps


def forward_step(
    r: Responses,
    accepted: Sequence[Candidate],
    best: SelectedEffect,
    verdict: Verdict,
    judged: Callable[[Model], Verdict],
    rivals: Rivals | None = None,
) -> list[SelectedEffect]:
    """The best candidate's effects, of a series those needed; or two that together explain far more.

    Of these the second has to pass beside the first. A fold tries no two but of what all poses show.
    """
    if best.candidate.beside is None:
        shown = [k for k, c in enumerate(verdict.candidates) if rivals is None or c.label in rivals]
        offered = [verdict.candidates[k] for k in shown]
        two = pair(r, accepted, offered, verdict.ratios[shown], best)
        of_second = two and judged(fitted_model(r, [*accepted, two[0]]))
        if two and of_second and of_second.passes:
            second = replace(best, candidate=two[1], rivals=(), p_value=of_second.p_value)
            return [replace(best, candidate=two[0], rivals=()), second]
    members: Sequence[Candidate] = needed_changes(r, accepted, best.candidate)
    if best.candidate.shape.series:
        members = needed(r, accepted, members)
    return [replace(best, candidate=member) for member in members]


def hidden(
    r: Responses, model: Model, verdict: Verdict, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """Two effects of which each alone leaves the other, which then looks like noise that wanders."""
    if model.fitted.noise.rho.max() < STRONG_RHO or not verdict.candidates:
        return []
    first = named(r, model.accepted, verdict.candidates, verdict.ratios, verdict.p_value)
    return with_another(r, model, first, judged)


def with_another(
    r: Responses, model: Model, first: SelectedEffect, judged: Callable[[Model], Verdict]
) -> list[SelectedEffect]:
    """An effect on trial and the best beside it, where each passes the gate beside the other.

    So enters what is worth no name alone: a slip that a warm-up undoes makes the reading worse without it.
    """
    beside = [*model.accepted, first.candidate]
    of_second = judged(fitted_model(r, beside))
    if not of_second.passes:
        return []
    second = named(r, beside, of_second.candidates, of_second.ratios, of_second.p_value)
    with_second = [*model.accepted, second.candidate]
    of_first = judged(fitted_model(r, with_second))
    worth = is_practically_significant(r, beside, second) and is_practically_significant(
        r, with_second, first
    )
    if not of_first.passes or not worth:
        return []
    both = (replace(first, p_value=of_first.p_value), second)
    return [replace(one, candidate=member) for one in both for member in one.candidate.members]


def plain(
    r: Responses, accepted: Sequence[Candidate], best: SelectedEffect, verdict: Verdict
) -> SelectedEffect:
    """The best candidate; of several effects offered as one, one alone where that says as much."""
    if best.candidate.beside is None or not _says_no_more(best, verdict.candidates):
        return best
    single = [k for k, c in enumerate(verdict.candidates) if c.beside is None]
    offered = [verdict.candidates[k] for k in single]
    return named(r, accepted, offered, verdict.ratios[single], verdict.p_value)


def _says_no_more(step: SelectedEffect, offered: Sequence[Candidate]) -> bool:
    """Whether one of several effects offered as one explains the poses nearly as well by itself.

    The more forms the two have together, the more of them fit noise a little better than one.
    """
    behind = dict(step.considered)
    same = [c for c in offered if c.label == step.candidate.label]
    # an instant has paid for its choice among all of them
    forms = len({tuple(m.shape.form for m in c.members) for c in same} if is_on_trial(same[0]) else same)
    margin = COMPANION_MARGIN + 2.0 * float(np.log(max(forms, 1)))
    return any(behind.get(member.label, np.inf) < margin for member in step.candidate.members)


def is_on_trial(candidate: Candidate) -> bool:
    """Whether it is a pair of which one was chosen among places that differ from one to the next."""
    return len(candidate.members) > 1 and any(
        m.shape.scanned and m.shape.place_cost > 1 for m in candidate.members
    )


def brings(pair: Candidate, one: Candidate) -> bool:
    """Whether an effect is among several that are offered as one."""
    return any(member.label == one.label for member in pair.members)


FREEDOM, ROUNDS = 3, 3


def offered(
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
        if c.shape.beside and not followed.issuperset(c.shape.beside):
            return False
        if c.label in once or not (c.follows is None or c.follows in present):
            return False
        return c.effect.distinct is None or all(c.is_distinct(r, other) for other in accepted)

    return [c for c in candidates if c.label not in refused and may_enter(c)]


def _enters_once(c: Candidate) -> bool:
    """Whether a second would say the same: it has no place, or one that its likelihood is smooth in."""
    return c.shape.at.keys() <= set(HIDDEN) or c.shape.place_cost == 1


def reconsidered(
    r: Responses,
    candidates: Sequence[Candidate],
    found: list[SelectedEffect],
    known: int,
    rivals: Rivals | None = None,
    *,
    fresh: SelectedEffect | None = None,
    curves: bool = False,
) -> list[SelectedEffect]:
    """Each effect but the first known ones against its rivals once more, with all the others in the model.

    It may bring a companion of its own with it, but none that was looked for at many instants: that would
    enter unjudged. What another one has given way to may change what explains the rest, hence again until
    nothing changes. One that was held against them with the same others, as a fresh one just has been, is not
    again.
    """
    if len(found) == known + 1:
        return found
    held = {} if fresh is None else {fresh: _places(_others(found, fresh))}
    for _ in range(ROUNDS):
        before = [f.candidate.label for f in found]
        for one in found[known:]:
            others = _places(_others(found, one))
            if held.get(one) == others:
                continue
            found = _against_rivals(r, near_among(candidates, one, rivals), found, one, curves=curves)
            held.update({f: others for f in found if _places(_others(found, f)) == others})
        if [f.candidate.label for f in found] == before:
            break
    return found


def _others(found: Sequence[SelectedEffect], one: SelectedEffect) -> list[Candidate]:
    return [f.candidate for f in found if f is not one]


def _places(candidates: Sequence[Candidate]) -> list[tuple[str, str, Parameters]]:
    """What tells one model of the same poses from another."""
    return [(c.label, c.shape.form, c.shape.at) for c in candidates]


def _against_rivals(
    r: Responses,
    candidates: Sequence[Candidate],
    found: list[SelectedEffect],
    one: SelectedEffect,
    *,
    curves: bool,
) -> list[SelectedEffect]:
    others = _others(found, one)
    rivals = [
        c
        for c in offered(r, candidates, others, set())
        if c.beside is None or c.shape.series or (brings(c, one.candidate) and not is_on_trial(c))
    ]
    if one.candidate.shape.series and not curves:  # they take a little from every term of a turn
        rivals = [c for c in rivals if c.named]
    model = fitted_model(r, others)
    ratios = Screen(r, model.columns, rivals, model.fitted.noise).once(model.fitted.residuals)
    again = named(r, others, rivals, ratios, one.p_value, one.candidate)
    place = next(k for k, f in enumerate(found) if f is one)
    members = [replace(again, candidate=member) for member in again.candidate.members]
    return [*found[:place], *members, *found[place + 1 :]]


LARGEST_CONDITION = 30.0
"""Condition index beyond which coefficients say more of each other than of the poses (Belsley, Kuh & Welsch,
Regression Diagnostics, 1980, section 3.2)."""
SAME_THING = 1e3
"""Condition index beyond which two effects are one under two names."""
CANCELS = 3.0
"""Times its sum with the others that an effect's part of the reading may be."""


def tenable(r: Responses, accepted: Sequence[Candidate]) -> bool:
    """Whether effects can all be true together: as physics allows them, and not one against another.

    Args:
        r: the responses.
        accepted: the effects of a model.
    """
    model = fitted_model(r, accepted)
    columns, fitted, r = model.columns, model.fitted, model.responses
    own = own_columns(columns, accepted)
    if not all(c.is_possible(fitted.beta[at]) for c, at in zip(accepted, own, strict=True)):
        return False
    if len(accepted) < 2:
        return True
    condition = _condition(r, columns, fitted, own)
    cancels = condition > LARGEST_CONDITION and _cancel(columns, fitted, own)
    return condition < SAME_THING and not cancels


def _condition(r: Responses, columns: FloatArray, fitted: Fit, own: Sequence[slice]) -> float:
    """Largest over smallest singular value of what the effects do to all responses, beside bias and scale."""
    design = stacked(fitted.noise, r.starts, columns)
    base, effects = design[:, : own[0].start], design[:, own[0].start :]
    beside = effects - base @ np.linalg.lstsq(base, effects, rcond=None)[0]
    size = np.linalg.norm(beside, axis=0)
    values = np.linalg.svd(beside / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return float(values[0] / max(values[-1], float(np.finfo(np.float64).tiny)))


def _cancel(columns: FloatArray, fitted: Fit, own: Sequence[slice]) -> bool:
    """Whether two effects add to the reading many times what all of them add together."""
    parts = np.stack([columns[:, 0, at] @ fitted.beta[at] for at in own])
    base = columns[:, 0, : own[0].start]
    beside = parts - (base @ np.linalg.lstsq(base, parts.T, rcond=None)[0]).T
    together = float(beside.sum(axis=0).std())
    return int((beside.std(axis=1) > CANCELS * together).sum()) >= 2


def parted(
    r: Responses, found: Sequence[SelectedEffect], known: int = 0
) -> tuple[list[SelectedEffect], list[str]]:
    """The effects that the others do not make superfluous, and the labels of those that they do.

    An effect is worth its place where the model without it is worse by more than log n a parameter. One
    that was dropped does not come back: so a search ends.

    Args:
        r: the responses.
        found: the effects of a model; the last to enter has passed the gate and stays.
        known: how many of the first were found in another base, and stay.
    """
    kept, dropped = list(found), []
    while len(kept) > 1:
        whole = fitted_model(r, [f.candidate for f in kept]).fitted.criterion
        followed = {f.candidate.follows for f in kept}
        free = [
            k
            for k, f in enumerate(kept[:-1])
            if k >= known and f.candidate.name not in followed and not f.candidate.effect.place
        ]
        worth = {k: _worth(r, kept, k, whole) for k in free}
        least = min(worth, key=worth.__getitem__, default=None)
        if least is None or worth[least] >= 0.0:
            break
        dropped.append(kept.pop(least).candidate.label)
    return kept, dropped


def _worth(r: Responses, found: Sequence[SelectedEffect], place: int, whole: float) -> float:
    """By how much the penalised criterion would be worse without an effect."""
    without = [f.candidate for k, f in enumerate(found) if k != place]
    penalty = float(np.log(len(r))) * found[place].candidate.parameters
    return fitted_model(r, without).fitted.criterion - whole - penalty


OUTLIER_STD = 12.0
"""Robust standard deviations (by the median absolute deviation) from the model without the pose."""
MOST_SHARE = 0.03
SUSPECTS = 3


def most_outliers(n: int) -> int:
    """How many of n poses may be left out; where more are far off, the model is to blame."""
    return max(1, int(MOST_SHARE * n))


def outlier(r: Responses, accepted: Sequence[Candidate], gain_to_beat: float = 0.0) -> int | None:
    """The pose that is best explained by having gone wrong alone; None where there is none.

    Args:
        r: the responses.
        accepted: the effects in the model.
        gain_to_beat: of the best effect that could enter instead, in −2 log likelihood with penalties.
    """
    columns = model_columns(_with_first_poses(r), accepted)
    fitted = fit(r, columns)
    residuals = fitted.residuals[:, 0]
    most, best = gain_to_beat, None
    for k in np.argsort(-np.abs(residuals), kind="stable")[:SUSPECTS]:
        # each channel of the pose lies where it will: as if it had not been taken
        freed = np.zeros((len(r), len(r.channels), len(r.channels)))
        freed[k] = np.diag(r.known[k].astype(float))
        without = fit(r, np.concatenate([columns, freed], axis=2))
        others = np.delete(without.residuals[:, 0], k)
        spread_deg = robust_std(others)
        distance_deg = abs(float(without.beta[columns.shape[2]]))
        gain = fitted.criterion - without.criterion - float(np.log(len(r))) * (len(r.channels) + 2)
        is_outlier = distance_deg > OUTLIER_STD * max(spread_deg, float(r.rounding[0]))
        if is_outlier and gain > most:
            most, best = gain, int(k)
    return best


def _with_first_poses(r: Responses) -> Responses:
    """The responses with the first pose of each run bound to the model like any other."""
    bound = [k for k, name in enumerate(r.base_names) if not name.endswith(".first")]
    return replace(r, base=r.base[:, :, bound], base_names=tuple(r.base_names[k] for k in bound))


def with_free_curve(r: Responses) -> Responses | None:
    """The responses with a curve of the elevation for each side; None where too few poses carry one."""
    sides = [np.ones(len(r), dtype=bool)]
    if r.approach is not None and len(np.unique(r.approach[r.approach != 0.0])) > 1:
        sides = [r.approach > 0.0, r.approach <= 0.0]
    enough = [count for count in MORE_KNOTS if len(r) >= POSES_A_KNOT * count * len(sides)]
    if not enough or len(np.unique(r.theta_deg)) <= max(enough) + 1:
        return None
    curve = natural_spline(r.theta_deg, max(enough))
    columns = [(np.column_stack([np.ones(len(r)), curve]).T * side).T for side in sides]
    own = np.concatenate([columns[0][:, 1:], *columns[1:]], axis=1)  # one side has the bias itself
    return _freed(r, own)


def _freed(r: Responses, own: FloatArray) -> Responses:
    """The responses with columns (n, p) for the reading, and as many for the accelerometer's angle."""
    seen = [name for name in (READING, ANGLE) if name in r.channels]
    freed = np.zeros((len(r), len(r.channels), len(seen) * own.shape[1]))
    for k, name in enumerate(seen):
        freed[:, r.channels.index(name), k * own.shape[1] : (k + 1) * own.shape[1]] = own
    names = (f"{name}.curve" for name in seen for _ in range(own.shape[1]))
    base = np.concatenate([r.base, freed], axis=2)
    return replace(r, base=base, base_names=(*r.base_names, *names))


def is_of_the_curve(candidate: Candidate) -> bool:
    """Whether a candidate says no more than that the sides have curves."""
    of_curve = {ELEVATION.name, APPROACH.name}
    return all(of_curve.issuperset(member.covariate.split(TIMES)) for member in candidate.members)


def leaves_more(r: Responses, residual_deg: FloatArray) -> bool:
    """Whether a model leaves several times what poses differ by from one to the next beside free curves.

    Args:
        r: the poses.
        residual_deg: (n,) of their readings.
    """
    free = with_free_curve(r)
    if free is None or r.starts.all():
        return False
    base = free.base[:, 0, :]
    beside = r.values[:, 0] - base @ np.linalg.lstsq(base, r.values[:, 0], rcond=None)[0]
    differences = np.diff(beside)[~r.starts[1:]]
    noise_deg = np.hypot(np.sqrt(np.mean(differences**2) / 2.0), r.rounding[0])
    return bool(residual_deg.std() > SEVERAL * noise_deg)


LEVEL, AT_FIRST = 0.01, 0.75
"""Nominal rate at which noise alone says something; the share of it spent before a search beside curves."""
MOST_EFFECTS, MOST_COLUMNS = 5, 0.35
"""A series, such as the orders of a turn, is one effect of several terms; columns to a pose at most."""


@dataclass(frozen=True, slots=True)
class Findings:
    """What a search found, and the fit of the model it arrived at.

    Attributes:
        responses: the poses it rests on; `kept` (m,) are their indices among those it was given.
    """

    responses: Responses
    kept: npt.NDArray[np.intp]
    found: tuple[SelectedEffect, ...]
    fitted: Fit
    columns: FloatArray
    least_p_value: float
    """What the bootstrap could have told at best."""
    noises: Noises = field(default_factory=dict)
    """What noise gained beside each model on the way."""


def search(
    r: Responses,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    *,
    bootstraps: int,
    decide_only: bool = False,
    rivals: Rivals | None = None,
    noises: Noises = MappingProxyType({}),
) -> Findings:
    """Finds the effects in some poses, and leaves outliers among those aside.

    Of several runs first those that show within them, each run with a bias of its own, then what the biases
    differ by, at half the level each.

    Args:
        r: the responses.
        candidates: of these poses (`candidates_of`).
        rng: of the gate's bootstrap.
        bootstraps: how many a step.
        decide_only: whether no p-value will be told.
        rivals: of each effect that a search of more poses found, the labels it is to be held against again.
        noises: what noise gained there.
    """
    judge = partial(gate, rng=rng, bootstraps=bootstraps, decide_only=decide_only)
    if len(r.run_ids) < 2:
        return _beside_curves(r, candidates, judge, rivals, noises)
    levels = [is_level(r, c.columns) for c in candidates]
    shapes = [c for c, of_level in zip(candidates, levels, strict=True) if not of_level]
    judge = partial(judge, level=LEVEL / 2.0)
    within = _search(with_free_levels(r), shapes, judge, rivals=rivals, noises=noises)
    kept = within.kept
    # what a place was scanned for shows within the runs or not at all
    between = [
        c.rows(kept)
        for c, of_level in zip(candidates, levels, strict=True)
        if of_level or not any(member.shape.scanned for member in c.members)
    ]
    # levels that differ look like noise that wanders: what wanders within the runs is the measure of it
    judge = partial(judge, noise=_noise_beside(within))
    whole = _search(r.rows(kept), between, judge, within.found, rivals, noises)
    return replace(whole, kept=kept[whole.kept], noises={**within.noises, **whole.noises})


def _beside_curves(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    rivals: Rivals | None,
    noises: Noises,
) -> Findings:
    """The search of one run; where it leaves too much, once more beginning with what no curve explains.

    The better of the two stands, by likelihood with penalties, in the same poses.
    """
    first = _search(r, candidates, partial(judge, level=AT_FIRST * LEVEL), rivals=rivals, noises=noises)
    r = r.rows(first.kept)
    free = with_free_curve(r)
    if free is None or not leaves_more(r, first.fitted.residuals[:, 0]):
        return first
    offered = [c.rows(first.kept) for c in candidates]
    others = [c for c in offered if not is_of_the_curve(c)]
    judge = partial(judge, level=(1.0 - AT_FIRST) * LEVEL)
    between = _search(free, others, judge, rivals=rivals, noises=noises)
    r, curves = r.rows(between.kept), [c.rows(between.kept) for c in offered if is_of_the_curve(c)]
    judge = partial(judge, noise=_noise_beside(between))
    again = _search(r, curves, judge, between.found, rivals, noises)
    again = _with_curves(again, [c.rows(again.kept) for c in curves], len(between.found))
    drawn = {**again.noises, **between.noises, **first.noises}
    first = replace(first, noises=drawn)
    again = replace(again, kept=first.kept[between.kept][again.kept], noises=drawn)
    return again if len(again.kept) == len(first.kept) and _criterion(again) < _criterion(first) else first


def _with_curves(findings: Findings, candidates: Sequence[Candidate], known: int) -> Findings:
    """The same with curves in the place of orders of a turn that was not made, where they explain more."""
    r = findings.responses
    if goes_round(r):
        return findings
    found = reconsidered(r, candidates, list(findings.found), known, curves=True)
    found, _ = parted(r, found, known)
    model = fitted_model(r, [f.candidate for f in found])
    return replace(findings, found=tuple(found), fitted=model.fitted, columns=model.columns)


def _noise_beside(freer: Findings) -> NoiseModel:
    """The noise that a model with a freer base leaves."""
    of_each = max(1.0, freer.columns.shape[2] / len(freer.responses.channels))
    return noise_of(freer.fitted.residuals, freer.responses, of_each, unbiased=True)


def _criterion(findings: Findings) -> float:
    parameters = sum(f.candidate.parameters for f in findings.found)
    return findings.fitted.criterion + float(np.log(len(findings.kept))) * parameters


def _search(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    known: Sequence[SelectedEffect] = (),
    rivals: Rivals | None = None,
    noises: Noises = MappingProxyType({}),
) -> Findings:
    """The search in one base, with effects in the model that are known already; `judge` is the gate.

    Round by round: the model is fitted and the best of all candidates judged; a pose gone wrong is left out,
    or the search ends; what passed is named, enters, and is held against its rivals with all the others; what
    cannot be, or is not needed any more, leaves.
    """
    found = list(known)
    refused: set[str] = set()
    kept, fewest = np.arange(len(r)), len(r) - most_outliers(len(r))
    drawn: dict[ModelKey, NullGains] = {}

    def judged(model: Model) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> FloatArray:
            return model_columns(model.responses, [*model.accepted, *more])

        seen, companions = model.responses, companions_of(model.accepted)
        those = offered(seen, candidates, model.accepted, refused)
        key = model_of(seen, model.accepted)
        verdict = judge(seen, columns_with, model.fitted, those, companions=companions, known=noises.get(key))
        if verdict.drawn is not None:
            drawn[key] = verdict.drawn
        return verdict

    while True:
        accepted = [f.candidate for f in found]
        model = fitted_model(r, accepted)
        verdict = judged(model)
        apart = outlier(model.responses, model.accepted, verdict.gain) if len(kept) > fewest else None
        if apart is not None:
            others = np.delete(np.arange(len(r)), apart)
            kept, r, candidates = kept[others], r.rows(others), [c.rows(others) for c in candidates]
            found = [f.rows(others) for f in found]
            continue
        steps: list[SelectedEffect] = []
        if verdict.passes and not _is_full(accepted, len(known)):
            best = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
            if is_practically_significant(r, accepted, best):
                best = plain(r, accepted, best, verdict)
                steps = forward_step(r, accepted, best, verdict, judged, rivals)
            elif companions_of([best.candidate]):
                steps = with_another(r, model, best, judged)
            if not steps:
                refused.add(best.candidate.label)
                continue
        elif not _is_full(accepted, len(known)):
            steps = hidden(r, model, verdict, judged)
        if not steps:
            return Findings(r, kept, tuple(found), model.fitted, model.columns, verdict.least_p_value, drawn)
        fresh = steps[0] if rivals is not None and len(steps) == 1 else None
        entered = reconsidered(r, candidates, [*found, *steps], len(known), rivals, fresh=fresh)
        entered = on_their_places(r, candidates, entered)
        if found and not tenable(r, [f.candidate for f in entered]):
            refused.add(steps[0].candidate.label)
            continue
        found, dropped = parted(r, entered, len(known))
        refused.update(dropped)


def _is_full(accepted: Sequence[Candidate], known: int) -> bool:
    """Whether the model has as many effects, but the first known ones, as a run is searched for."""
    if len(accepted) == known:
        return False
    own = accepted[known:]
    series = {c.shape.series for c in own if c.shape.series}
    alone = sum(not c.shape.series for c in own)
    columns = sum(c.columns.shape[2] for c in accepted)
    return len(series) + alone >= MOST_EFFECTS or columns > MOST_COLUMNS * len(accepted[0].columns)
