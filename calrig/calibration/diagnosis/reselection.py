"""Reselection and backward elimination: the effects of a model once another one has entered.

Each effect is compared with its competitors again, with all others in the model; what is physically
impossible together, or not needed any more, leaves. Forward steps alone keep what once helped: two curves of
222° and 243° that cancel, an offset of 2.8 g against an eccentricity, a cycle of time that the angle has
explained since.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, permutations

import numpy as np

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    at_its_elevations,
    distinct_from,
    harmonics_of,
    is_term_of,
    orders_beside,
    own_columns,
)
from calrig.calibration.diagnosis.ranking import (
    MARGIN,
    SelectedEffect,
    at_best_place,
    candidates_in,
    named,
    within_reach,
)
from calrig.calibration.diagnosis.screen import Screen
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.regression.channels import READING
from calrig.calibration.regression.effect import ELEVATION, HIDDEN, Parameters
from calrig.calibration.regression.responses import Responses
from calrig.estimation.angles import FloatArray

HOPELESS = 80.0
"""Difference of the criterion beyond which a candidate no longer competes with an effect of all poses; with a
quarter of the poses left out, the same candidate is some 60 behind."""
COMPETING_SHARE = 0.4
"""Of an effect's gain on the screen, what a scanned place must reach to compete with it in a fold."""


@dataclass(frozen=True, slots=True)
class Rivals:
    """What a fold takes from the search of all poses.

    Attributes:
        labels: of competing candidates, by the label of the effect.
        places: keys of scanned candidates that compete with any of the effects.
        beside_curve: whether the model that was kept was searched for beside a free curve first.
    """

    labels: Mapping[str, Collection[str]]
    places: Collection[object]
    beside_curve: bool


def competing_candidates(
    r: Responses,
    candidates: Sequence[Candidate],
    found: Sequence[SelectedEffect],
    *,
    beside_curve: bool = False,
) -> Rivals:
    """Return the competing candidates of the selected effects: those within ΔBIC 80 on all poses.

    All other selected effects are among them, singly and in pairs: until those enter, the effect may stand in
    for them. A fold reconsiders an entered effect only against these.
    """
    labels = [f.candidate.label for f in found]
    every = {*labels, *(" + ".join(two) for two in permutations(labels, 2))}
    near: dict[str, set[str]] = {label: set(every) for label in labels}
    scanned = [c for c in candidates if _is_scanned(c)]
    places = {place_of(c) for c in scanned if any(_is_at_place_of(r, c, f.candidate) for f in found)}
    for f in found:
        near[f.candidate.label].update(label for label, behind in f.considered if behind < HOPELESS)
        if scanned:
            others = _others(found, f)
            model = fitted_model(r, others)
            several = [*offered(model.responses, scanned, others, set()), f.candidate]
            ratios = Screen(r, model.columns, several, model.fitted.noise).once(model.fitted.residuals)
            close = np.flatnonzero(ratios >= COMPETING_SHARE * ratios[-1])
            places.update(place_of(several[k]) for k in close.tolist())
    return Rivals(near, places, beside_curve)


def _is_scanned(candidate: Candidate) -> bool:
    """Return whether a candidate is one of many places of one nonlinear parameter."""
    return candidate.beside is None and candidate.shape.scanned


def place_of(candidate: Candidate) -> object:
    """Return what tells a candidate from all others: names, forms and places."""
    return tuple((c.label, c.shape.form, tuple(c.shape.at.items())) for c in candidate.members)


def _is_at_place_of(r: Responses, c: Candidate, other: Candidate) -> bool:
    """Return whether a candidate is another one at its place, or so near that these poses see one."""
    if c.label != other.label or c.beside is not None:
        return False
    return place_of(c) == place_of(other) if c.effect.resolved is None else not c.is_distinct(r, other)


def near_among(
    candidates: Sequence[Candidate], one: SelectedEffect, rivals: Rivals | None
) -> Sequence[Candidate]:
    """Return the candidates that compete with an effect; all, where its competitors are not known."""
    near = None if rivals is None else rivals.labels.get(one.candidate.label)
    if rivals is None or near is None:
        return candidates
    return [c for c in candidates if c.label in near and (not _is_scanned(c) or place_of(c) in rivals.places)]


def penalised_criterion(r: Responses, model: Sequence[Candidate]) -> float:
    """Return −2 log likelihood of a model plus log n for each parameter (BIC)."""
    parameters = sum(c.parameters for c in model)
    return fitted_model(r, model).fitted.criterion + float(np.log(len(r))) * parameters


def pruned(
    terms: Sequence[Candidate], criterion: Callable[[Sequence[Candidate]], float], margin: float
) -> Sequence[Candidate]:
    """Drop the least needed of several terms while that costs less than a margin of the criterion."""
    kept = list(terms)
    while len(kept) > 1:
        fewer = min(([term for term in kept if term is not one] for one in kept), key=criterion)
        if criterion(fewer) - criterion(kept) >= margin:
            break
        kept = fewer
    return kept


def needed_terms(
    r: Responses, accepted: Sequence[Candidate], terms: Sequence[Candidate]
) -> Sequence[Candidate]:
    """Return the terms of a series that a model needs, such as some orders of the turn; else all."""
    if not terms[0].shape.series:
        return terms
    return pruned(terms, lambda kept: penalised_criterion(r, [*accepted, *kept]), MARGIN)


def is_on_trial(candidate: Candidate) -> bool:
    """Return whether a pair has a member that was chosen among scanned instants."""
    return len(candidate.members) > 1 and any(
        m.shape.scanned and m.shape.place_cost > 1 for m in candidate.members
    )


FREEDOM, ROUNDS = 3, 3
KEPT = 8
"""Sets of poses that a search asks for again."""
MOST_WORSE = 2.0 * MARGIN
"""Of the criterion, by which another name for an effect may leave a model with a delay worse: a name within
`MARGIN` of the best is claimed, and some more for the choice among forms."""


def offered(
    r: Responses,
    candidates: Sequence[Candidate],
    accepted: Sequence[Candidate],
    refused: set[str],
    wanted: Callable[[Candidate], bool] = lambda _: True,
) -> list[Candidate]:
    """Return the candidates that may enter a model, and are wanted.

    Excluded are effects that are in it, effects that need one that is not, and candidates that would leave
    the reading hardly a degree of freedom.
    """
    taken = sum(name.startswith(READING) for name in r.base_names)
    room = _distinct_poses(r) - taken - sum(c.columns.shape[2] for c in accepted) - FREEDOM
    present = {c.name for c in accepted}
    followed = {c.covariate for c in accepted}
    always = {c.name for c in accepted if c.changed is None}
    once = {c.label for c in accepted if c.named and _enters_once(c)}
    is_distinct = distinct_from(r, accepted)

    def may_enter(c: Candidate) -> bool:
        if c.columns.shape[2] > room:
            return False
        if c.beside is not None:
            if c.shape.series:  # other terms of it may be in the model
                return not any(one.label in once for one in c.members) and all(
                    is_distinct(one) for one in c.members
                )
            return not any(one.label in once or one.name in always for one in c.members)
        if c.shape.beside and not followed.issuperset(c.shape.beside):
            return False
        if c.label in once or not (c.follows is None or c.follows in present):
            return False
        return is_distinct(c)

    every = [*candidates, *harmonics_of(r, accepted)]
    allowed = [c for c in every if c.label not in refused and wanted(c) and may_enter(c)]
    return [at_its_elevations(r, c) for c in allowed] if r.is_delayed else allowed


@lru_cache(maxsize=KEPT)
def _distinct_poses(r: Responses) -> int:
    """Return how many poses are unlike all others: a row that is repeated leaves no freedom."""
    return len(np.unique(np.column_stack([r.theta_deg, r.values]), axis=0))


def _enters_once(c: Candidate) -> bool:
    """Return whether an effect enters once: it has no nonlinear parameter, or a smooth likelihood in it."""
    return c.shape.at.keys() <= set(HIDDEN) or c.shape.place_cost == 1


def reselected(
    r: Responses,
    candidates: Sequence[Candidate],
    found: list[SelectedEffect],
    known: int,
    rivals: Rivals | None = None,
    *,
    fresh: SelectedEffect | None = None,
    curves: bool = False,
    thorough: bool = True,
) -> list[SelectedEffect]:
    """Compare each effect with its competitors again, with all others in the model, until nothing changes.

    An effect may bring a companion, but none that was scanned for at many instants: it would enter untested.
    Without `thorough` an effect that leads far on the screen only moves to its best place.

    The first `known` were found in another base, and stay. Without `rivals` all candidates compete. `fresh`
    was just compared with the same others in the model. With `curves`, which may replace the terms of a
    series, as orders are, only these are compared.
    """
    if len(found) == known + 1:
        return found
    held = {} if fresh is None else {fresh: _places(_others(found, fresh))}
    for _ in range(ROUNDS):
        before = [f.candidate.label for f in found]
        for one in found[known:]:
            others = _places(_others(found, one))
            if held.get(one) == others or (curves and not one.candidate.shape.series):
                continue
            near = near_among(candidates, one, rivals)
            found = _against_rivals(r, near, found, one, thorough=thorough, curves=curves)
            held.update({f: others for f in found if _places(_others(found, f)) == others})
        if [f.candidate.label for f in found] == before:
            break
    return found


def _brings(pair: Candidate, one: SelectedEffect) -> bool:
    """Return whether an effect is among several that are offered as one."""
    return any(member.label == one.candidate.label for member in pair.members)


def _others(found: Sequence[SelectedEffect], one: SelectedEffect) -> list[Candidate]:
    return [f.candidate for f in found if f is not one]


def _places(candidates: Sequence[Candidate]) -> list[tuple[str, str, Parameters]]:
    """Return what distinguishes one model of the same poses from another."""
    return [(c.label, c.shape.form, c.shape.at) for c in candidates]


def _against_rivals(
    r: Responses,
    candidates: Sequence[Candidate],
    found: list[SelectedEffect],
    one: SelectedEffect,
    *,
    thorough: bool,
    curves: bool,
) -> list[SelectedEffect]:
    """Replace an effect by the best of its competitors, with all others in the model."""
    others = _others(found, one)
    model = fitted_model(r, others)
    # a curve takes a little from every order of a turn; what is of time or direction has to pass a test
    names_only = one.candidate.shape.series != "" and not curves
    its = one.candidate.covariate

    def competes(c: Candidate) -> bool:
        if names_only and not (c.named and all(member.covariate == its for member in c.members)):
            return False
        return c.beside is None or c.shape.series != "" or (_brings(c, one) and not is_on_trial(c))

    orders = orders_beside(r, candidates, others) if its == ELEVATION.name and not one.candidate.named else ()
    rivals = offered(model.responses, [*candidates, *orders], others, set(), competes)
    if not rivals:
        return found
    ratios = Screen(r, model.columns, rivals, model.fitted.noise).once(model.fitted.residuals)
    if not thorough:
        rivals, ratios = within_reach(r, rivals, ratios)
    if not thorough and all(_is_at_place_of(r, c, one.candidate) for c in rivals):
        again = replace(one, candidate=at_best_place(r, others, one.candidate))
    else:
        again = named(r, others, rivals, ratios, one.p_value, one.candidate)
    if any(is_term_of(c, one.candidate) for c in others) and _is_at_place_of(
        r, again.candidate, one.candidate
    ):
        again = replace(again, candidate=one.candidate)  # its terms move with it (`with_families`)
    place = next(k for k, f in enumerate(found) if f is one)
    # a term without a size would give its place in the model to an effect that no test has passed
    terms = needed_terms(r, others, again.candidate.members)
    members = [replace(again, candidate=term).at_elevations_of(r) for term in terms]
    changed = [*found[:place], *members, *found[place + 1 :]]
    before, after = ([f.candidate for f in some] for some in (found, changed))
    is_another = [m.candidate.label for m in members] != [one.candidate.label]
    if is_another and is_admissible(r, before) and not is_admissible(r, after):
        return found
    if not fitted_model(r, before).responses.is_delayed or not _are_possible(r, before):
        return changed
    # ranked by fits beside the others, which stay linear where they do not come to rest: a delay bends most
    is_worse = penalised_criterion(r, after) > penalised_criterion(r, before) + MOST_WORSE
    return found if is_worse else changed


def with_known_places(
    r: Responses, candidates: Sequence[Candidate], found: list[SelectedEffect]
) -> list[SelectedEffect]:
    """Move scanned nonlinear parameters to the known values nearby, if the model improves.

    Each was refined while other effects were missing, so all are tried at once, then one by one. Between two
    known values, such as orders 6 and 7 of one turn, one may stand for both.
    """
    there = {place_of(f.candidate) for f in found}
    known = [c for c in candidates if c.shape.series and not c.shape.scanned and c.beside is None]
    known = [c for c in known if place_of(c) not in there]
    beside = {f.candidate: _beside(r, f.candidate, known) for f in found}
    nearest = {c: near[:1] for c, near in beside.items() if near}
    both = {c: near for c, near in beside.items() if len(near) == 2}
    for moves in (nearest, *({c: near} for those in (nearest, both) for c, near in those.items())):
        put = [
            f if place is f.candidate else replace(f, candidate=place)
            for f in found
            for place in moves.get(f.candidate, [f.candidate])
        ]
        before, after = ([f.candidate for f in each] for each in (found, put))
        moved = [k for k, one in enumerate(put) if all(one is not f for f in found)]
        beside_it = ((k, m) for k in moved for m in range(len(after)) if m != k)
        if any(not after[k].is_distinct(r, after[m]) for k, m in beside_it):
            continue  # two that these poses see as one would cancel each other
        if penalised_criterion(r, after) < penalised_criterion(r, before):
            found = put
    return found


def _beside(r: Responses, candidate: Candidate, known: Sequence[Candidate]) -> list[Candidate]:
    """Return the nearest known value, which these poses do not resolve from a candidate's; none without one.

    Then the nearest one on the other side.
    """
    name = candidate.effect.place
    if not name or candidate.shape.series:
        return []
    at = candidate.shape.at[name]
    by_distance = sorted(
        (c for c in known if c.label == candidate.label), key=lambda c: abs(c.shape.at[name] - at)
    )
    alike = [c for c in by_distance if not c.is_distinct(r, candidate)][:1]
    beyond = [c for c in by_distance if alike and (c.shape.at[name] > at) != (alike[0].shape.at[name] > at)]
    return [*alike, *(c for c in beyond[:1] if c.is_distinct(r, alike[0]))]


SAME_THING = 1e3
"""Condition index beyond which two effects are one under two names (Belsley, Kuh & Welsch, Regression
Diagnostics, 1980, section 3.2)."""
CANCELS = 3.0
"""Largest part of an effect in the responses, as a multiple of what several add together."""


def is_admissible(r: Responses, accepted: Sequence[Candidate]) -> bool:
    """Return whether effects can be true together: physically possible, and none cancels another."""
    if not _are_possible(r, accepted):
        return False
    if len(accepted) < 2:
        return True
    model = fitted_model(r, accepted)
    own = own_columns(model.columns, accepted)
    beside = _beside_base(model, own)
    parts = np.stack([one @ model.fitted.beta[at] for one, at in zip(beside, own, strict=True)])
    return _condition(beside) < SAME_THING and not _cancel(parts)


def admitted(
    r: Responses, found: Sequence[SelectedEffect], entered: list[SelectedEffect], known: int
) -> list[SelectedEffect] | None:
    """Return the effects of a model that can be true together: all, or all but one that others stand for.

    None where nothing admissible is better. The first `known` were found in another base, and stay.
    """
    if is_admissible(r, candidates_in(entered)):
        return entered
    followed = {f.candidate.follows for f in entered}
    may_leave = [f for f in entered[known:] if f.candidate.name not in followed]
    fewer = [[f for f in entered if f is not one] for one in may_leave]
    fewer = [those for those in fewer if is_admissible(r, candidates_in(those))]
    best = min(fewer, key=lambda those: penalised_criterion(r, candidates_in(those)), default=list(found))
    is_better = penalised_criterion(r, candidates_in(best)) < penalised_criterion(r, candidates_in(found))
    return best if is_better else None


def _are_possible(r: Responses, accepted: Sequence[Candidate]) -> bool:
    """Return whether each of the effects of a model is physically possible by itself."""
    model = fitted_model(r, accepted)
    own = own_columns(model.columns, accepted)
    return all(c.is_possible(model.fitted.beta[at]) for c, at in zip(accepted, own, strict=True))


def _beside_base(model: Model, own: Sequence[slice]) -> list[FloatArray]:
    """Return (n·J, p) columns of each effect in all responses over their residuals, without the base."""
    noise = np.hypot(model.fitted.residuals.std(axis=0), model.responses.rounding)
    design = (model.columns / noise[:, None]).reshape(-1, model.columns.shape[2])
    base = design[:, : own[0].start]
    beside = design - base @ np.linalg.lstsq(base, design, rcond=None)[0]
    return [beside[:, at] for at in own]


def _condition(beside: Sequence[FloatArray]) -> float:
    """Return the condition index of effects; how a curve's own columns lie to each other says nothing."""
    values = np.linalg.svd(np.hstack([np.linalg.qr(one)[0] for one in beside]), compute_uv=False)
    return float(values[0] / max(values[-1], float(np.finfo(np.float64).tiny)))


def _cancel(parts: FloatArray) -> bool:
    """Return whether two effects add to the responses many times what they, or all effects, add together.

    Two are compared with each other too: a large effect beside them hides how little is left of both.
    """
    pairs = [list(pair) for pair in combinations(range(len(parts)), 2)]
    return any(_two_exceed(parts[those]) for those in [list(range(len(parts))), *pairs])


def _two_exceed(parts: FloatArray) -> bool:
    together = float(np.linalg.norm(parts.sum(axis=0)))
    return int((np.linalg.norm(parts, axis=1) > CANCELS * together).sum()) >= 2


def eliminated(
    r: Responses, found: Sequence[SelectedEffect], known: int = 0
) -> tuple[list[SelectedEffect], list[str]]:
    """Eliminate backward: return the effects that the model needs, and the labels of those dropped.

    An effect is needed where the model without it is worse by more than log n a parameter. A dropped label is
    not offered again, so a search ends.

    The last to enter has passed the significance test and stays, and so do the first `known`, which were
    found in another base.
    """
    kept, dropped = list(found), []
    while len(kept) > 1:
        whole = penalised_criterion(r, [f.candidate for f in kept])
        followed = {f.candidate.follows for f in kept}
        free = [
            k
            for k, f in enumerate(kept[:-1])
            if k >= known and f.candidate.name not in followed and not f.candidate.effect.place
        ]
        without = {k: penalised_criterion(r, _others(kept, kept[k])) for k in free}
        least = min(without, key=without.__getitem__, default=None)
        if least is None or without[least] >= whole:
            break
        dropped.append(kept.pop(least).candidate.label)
    return kept, dropped
