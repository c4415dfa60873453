"""Effects that have entered, held against their rivals once more, with all the others in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calrig.calibration.candidates import Candidate
from calrig.calibration.channels import READING
from calrig.calibration.effect import HIDDEN, Parameters
from calrig.calibration.entering import brings, is_on_trial
from calrig.calibration.near_rivals import Rivals, near_among
from calrig.calibration.ranking import Found, named
from calrig.calibration.responses import Responses
from calrig.calibration.screen import Screen
from calrig.calibration.sensor_model import fitted_model

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
    found: list[Found],
    known: int,
    rivals: Rivals | None = None,
    *,
    fresh: Found | None = None,
    curves: bool = False,
) -> list[Found]:
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


def _others(found: Sequence[Found], one: Found) -> list[Candidate]:
    return [f.candidate for f in found if f is not one]


def _places(candidates: Sequence[Candidate]) -> list[tuple[str, str, Parameters]]:
    """What tells one model of the same poses from another."""
    return [(c.label, c.shape.form, c.shape.at) for c in candidates]


def _against_rivals(
    r: Responses, candidates: Sequence[Candidate], found: list[Found], one: Found, *, curves: bool
) -> list[Found]:
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
