"""The search: effects enter one by one while the gate lets one through, each is held against its rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calrig.calibration.backward import parted, tenable
from calrig.calibration.candidates import Candidate, companions_of, goes_round
from calrig.calibration.entering import entering, hidden, plain, with_another
from calrig.calibration.gate import Verdict, gate
from calrig.calibration.known_noise import KnownNoise, ModelKey, Noises, model_of
from calrig.calibration.model import model_columns
from calrig.calibration.near_rivals import Rivals
from calrig.calibration.noise_model import Fit, NoiseModel, noise_of
from calrig.calibration.outliers import most_outliers, outlier
from calrig.calibration.ranking import Found, named
from calrig.calibration.reconsidering import offered, reconsidered
from calrig.calibration.responses import Responses
from calrig.calibration.revisits import is_of_the_curve, leaves_more, with_free_curve
from calrig.calibration.run_changes import is_level, with_free_levels
from calrig.calibration.sensor_model import Model, fitted_model
from calrig.calibration.series import on_their_places
from calrig.calibration.worth import is_worth_a_name
from calrig.estimation.angles import FloatArray

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
    found: tuple[Found, ...]
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
    known: Sequence[Found] = (),
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
    drawn: dict[ModelKey, KnownNoise] = {}

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
        steps: list[Found] = []
        if verdict.passes and not _is_full(accepted, len(known)):
            best = named(r, accepted, verdict.candidates, verdict.ratios, verdict.p_value)
            if is_worth_a_name(r, accepted, best):
                best = plain(r, accepted, best, verdict)
                steps = entering(r, accepted, best, verdict, judged, rivals)
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
