"""Select effects forward while the significance test passes; reselect, eliminate and drop outliers.

An axis' error may be wavy all along and differ by direction. Half explained it looks like noise that wanders,
and hides what steps or drifts. With a free curve for each side in the base, that shows by itself: what poses
revisited from one side differ by is no function of the elevation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calrig.calibration.diagnosis.candidates import (
    Candidate,
    companions_of,
    is_term_of,
    orders_beside,
    term_alike,
)
from calrig.calibration.diagnosis.entering import entering, likeliest
from calrig.calibration.diagnosis.families import with_families
from calrig.calibration.diagnosis.lack_of_fit import free_cells, is_of_rounding, leaves_more, with_free_curve
from calrig.calibration.diagnosis.outliers import most_outliers, outliers
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.reselection import (
    Rivals,
    admitted,
    eliminated,
    is_admissible,
    offered,
    place_of,
    reselected,
    with_known_places,
)
from calrig.calibration.diagnosis.sensor_model import Model, fitted_model
from calrig.calibration.diagnosis.significance_test import (
    ModelKey,
    Noises,
    NullGains,
    Verdict,
    gate,
    model_of,
)
from calrig.calibration.effects.unnamed import UNSTEADY, VISITS
from calrig.calibration.regression.column_units import TIMES
from calrig.calibration.regression.effect import APPROACH, ELEVATION
from calrig.calibration.regression.noise_model import Fit, NoiseModel, noise_of
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.run_changes import is_level, with_free_levels
from calrig.calibration.regression.terms import goes_round
from calrig.estimation.angles import FloatArray


def is_of_the_curve(candidate: Candidate) -> bool:
    """Return whether a candidate depends on elevation and approach alone."""
    of_curve = {ELEVATION.name, APPROACH.name}
    return all(
        of_curve.issuperset(member.covariate.split(TIMES)) and member.shape.form != UNSTEADY
        for member in candidate.members
    )


def _is_of_poses_alone(candidate: Candidate) -> bool:
    """Return whether a candidate is a function of the elevation, or cycles along the rows."""
    of = {member.covariate for member in candidate.members}
    return of <= {ELEVATION.name} or (of == {"time_s"} and "period" in candidate.shape.at)


LEVEL, AT_FIRST = 0.01, 0.75
"""Family-wise significance level of a search; the share of it spent before a search with free curves."""
MOST_CAUSES, IN_A_FOLD, MOST_COLUMNS = 8, 12, 0.35
"""Most causes in a model, such as the orders of a turn or a worm with harmonics; in a fold, where aliases may
come first and leave later; most columns per pose."""


@dataclass(frozen=True, slots=True)
class Findings:
    """The selected effects of a search, and the fit of the final model.

    Attributes:
        responses: the poses without outliers.
        kept: (m,) their indices among the poses that were searched.
        columns: (m, J, p) of the model.
        least_p_value: the smallest that the bootstrap could have given.
        noises: null distributions drawn on the way, by model.
        beside_curve: whether what no free curve explains was searched for first.
    """

    responses: Responses
    kept: npt.NDArray[np.intp]
    found: tuple[SelectedEffect, ...]
    fitted: Fit
    columns: FloatArray
    least_p_value: float
    noises: Noises = field(default_factory=dict)
    beside_curve: bool = False


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
    """Search some poses for effects, and leave outliers out.

    In several runs, search first for effects within them, each run with a free bias, then for differences
    between the biases, at half the level each.

    A test has at most so many `bootstraps`; with `decide_only` no p-value will be reported. `rivals` and
    `noises` are of a search of more poses: of each effect the labels that compete with it, and the null
    distributions.
    """
    judge = partial(gate, rng=rng, bootstraps=bootstraps, decide_only=decide_only)
    if len(r.run_ids) < 2:
        return _search_one_run(r, candidates, judge, rivals, noises)
    levels = [is_level(r, c.columns) for c in candidates]
    shapes = [c for c, of_level in zip(candidates, levels, strict=True) if not of_level]
    judge = partial(judge, level=LEVEL / 2.0)
    within = _search(with_free_levels(r), shapes, judge, rivals=rivals, noises=noises)
    kept = within.kept
    # An effect that was scanned for shows within the runs or not at all.
    between = [
        c.rows(kept)
        for c, of_level in zip(candidates, levels, strict=True)
        if of_level or not any(member.shape.scanned for member in c.members)
    ]
    # Differing biases look like slow noise, so the noise is that of the model with free biases.
    judge = partial(judge, noise=_noise_left_by(within))
    whole = _search(r.rows(kept), between, judge, within.found, rivals, noises)
    return replace(whole, kept=kept[whole.kept], noises={**within.noises, **whole.noises})


def _search_one_run(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    rivals: Rivals | None,
    noises: Noises,
) -> Findings:
    """Search one run; if too much is left, search again, first for what no free curve explains.

    At a few places, often visited, the second alone: what else is a function of place and approach is not
    told apart from a curve there.

    The second is kept if its penalised criterion is smaller than that of the first on the same poses, before
    the effects of the first are compared thoroughly. A fold makes only the search whose model was kept of all
    poses; with too few poses for a free curve, the first one.
    """
    at_first = partial(judge, level=AT_FIRST * LEVEL)
    is_beside = free_cells(r) is not None if rivals is None else rivals.beside_curve
    if is_beside:  # at a level that the draws of a fold can reach
        again = _beside_free_curve(r, candidates, at_first, rivals, noises)
        if again is not None:
            return again
    judge = partial(judge, level=(1.0 - AT_FIRST) * LEVEL)

    def better(first: Findings) -> Findings | None:
        r, again = first.responses, None
        if leaves_more(r, first.fitted.residuals[:, 0]):
            again = _beside_free_curve(r, [c.rows(first.kept) for c in candidates], judge, rivals, noises)
        if again is None or len(again.kept) < len(first.kept) or _criterion(again) >= _criterion(first):
            return None
        return replace(again, kept=first.kept[again.kept], noises={**again.noises, **first.noises})

    return _search(r, candidates, at_first, rivals=rivals, noises=noises, better=None if rivals else better)


def _beside_free_curve(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    rivals: Rivals | None,
    noises: Noises,
) -> Findings | None:
    """Search first for what no free curve explains, then for curves; None where poses are too few."""
    free = with_free_curve(r, VISITS if rivals is None else VISITS / 2.0)  # a fold has fewer of the same
    if free is None:
        return None
    others = [c for c in candidates if not is_of_the_curve(c)]
    between = _search(free, others, judge, rivals=rivals, noises=noises)
    kept = between.kept
    curves = [c.rows(kept) for c in candidates if is_of_the_curve(c)]
    judge = partial(judge, noise=_noise_left_by(between))
    again = _search(r.rows(kept), curves, judge, between.found, rivals, noises)
    kept, curves = kept[again.kept], [c.rows(again.kept) for c in curves]
    bent = _with_curves(again, curves, len(between.found), rivals)
    bent_model, model = ({place_of(f.candidate) for f in those.found} for those in (bent, again))
    if bent_model != model:  # beside a curve more may be seen
        known, begun = bent.found[: len(between.found)], bent.found[len(between.found) :]
        more = _search(bent.responses, curves, judge, known, rivals, noises, begun)
        again, kept = replace(more, noises={**more.noises, **again.noises}), kept[more.kept]
    return replace(again, kept=kept, noises={**again.noises, **between.noises}, beside_curve=True)


def _with_curves(
    findings: Findings, candidates: Sequence[Candidate], known: int, rivals: Rivals | None
) -> Findings:
    """Replace orders of the turn by curves, in poses that do not cover a turn, where these explain more."""
    r = findings.responses
    if goes_round(r):
        return findings
    found = list(findings.found)
    found = reselected(r, candidates, found, known, rivals, curves=True, thorough=rivals is None)
    found, _ = eliminated(r, found, known)
    model = fitted_model(r, [f.candidate for f in found])
    return replace(findings, found=tuple(found), fitted=model.fitted, columns=model.columns)


def _noise_left_by(freer: Findings) -> NoiseModel:
    of_each = max(1.0, freer.columns.shape[2] / len(freer.responses.channels))
    return noise_of(freer.fitted.residuals, freer.responses, of_each)


def _criterion(findings: Findings) -> float:
    parameters = sum(f.candidate.parameters for f in findings.found)
    return findings.fitted.criterion + float(np.log(len(findings.kept))) * parameters


@dataclass(slots=True)
class _Judge:
    """Tests what may enter a model.

    Attributes:
        judge: the significance test, at its level.
        candidates: of the poses.
        noises: null distributions drawn in a search of more poses.
        refused: labels that are offered no more.
        drawn: null distributions drawn here, by model.
    """

    judge: Callable[..., Verdict]
    candidates: Sequence[Candidate]
    noises: Noises
    refused: set[str] = field(default_factory=set)
    drawn: dict[ModelKey, NullGains] = field(default_factory=dict)

    def __call__(self, model: Model, earlier: Verdict | None = None) -> Verdict:
        """Judge all that may enter a model, or what has not been refused since an earlier verdict on it."""
        seen, key = model.responses, model_of(model.responses, model.accepted)
        orders = orders_beside(seen, self.candidates, model.accepted)
        if any(c.label in self.refused for c in orders):  # fewer of them say no more
            self.refused.update(c.label for c in orders)
        if earlier is None:
            those = offered(seen, [*self.candidates, *orders], model.accepted, self.refused)
            trial = None
        else:
            those, trial = [c for c in earlier.candidates if c.label not in self.refused], earlier.trial
        if is_of_rounding(seen, model.fitted.residuals[:, 0]):
            those = [c for c in those if not _is_of_poses_alone(c)]
        verdict = self.judge(
            seen,
            model.columns_with,
            model.fitted,
            those,
            companions=companions_of(model.accepted) | {c.label for c in orders},
            known=self.noises.get(key),
            earlier=trial,
        )
        if verdict.drawn is not None:
            self.drawn[key] = verdict.drawn
        return verdict


def _search(
    r: Responses,
    candidates: Sequence[Candidate],
    judge: Callable[..., Verdict],
    known: Sequence[SelectedEffect] = (),
    rivals: Rivals | None = None,
    noises: Noises = MappingProxyType({}),
    begun: Sequence[SelectedEffect] = (),
    better: Callable[[Findings], Findings | None] | None = None,
) -> Findings:
    """Search in one base, with the `known` effects in the model from the start; `judge` tests significance.

    So are those `begun` with, which need not stay. `better` gets the findings before effects are compared
    thoroughly; if it returns others, these are returned.

    In each round the model is fitted and all candidates are tested. Outliers are left out; else the best
    significant candidate enters and all effects are reselected; inadmissible or needless ones leave. The
    search ends where nothing enters, and where a round ends as an earlier one did: of effects that replace
    each other in turn, the same would come for ever. Outside a fold, all effects are compared thoroughly
    before it ends.
    """
    found = [*known, *begun]
    judged = _Judge(judge, candidates, noises)
    refused = judged.refused
    kept, fewest = np.arange(len(r)), len(r) - most_outliers(len(r))
    met: set[object] = set()
    is_compared = False  # every effect thoroughly with its competitors, as all others are now
    earlier: Verdict | None = None  # of the same model, before the last candidate was refused
    while True:
        accepted = [f.candidate for f in found]
        state = len(kept), frozenset(refused), frozenset(place_of(c) for c in accepted)
        if state in met:
            break
        model = fitted_model(r, accepted)
        verdict, earlier = judged(model, earlier), None
        apart = outliers(model.responses, model.accepted, len(kept) - fewest, verdict.gain)
        if not len(apart):
            met.add(state)
            is_full = _is_full(r, accepted, len(known), MOST_CAUSES if rivals is None else IN_A_FOLD)
            steps, no_worth = ([], None) if is_full else entering(r, model, accepted, verdict, judged, rivals)
            if no_worth is not None:
                refused.add(no_worth)
                earlier = verdict
                continue
            if not steps:  # nothing enters instead of them, whatever it would gain
                apart = outliers(model.responses, model.accepted, len(kept) - fewest)
            if not steps and not len(apart) and not is_full:
                apart = _hiding(r, model, verdict, judged, len(kept) - fewest)
        if len(apart):
            others = np.delete(np.arange(len(r)), apart)
            kept, r, found = kept[others], r.rows(others), [f.rows(others) for f in found]
            judged.candidates = candidates = [c.rows(others) for c in candidates]
            continue
        if not steps:
            if rivals is not None or is_compared:
                break
            instead, better = better and better(_findings(r, kept, found, verdict, judged)), None
            if instead:
                return instead
            found, is_compared = _compared(r, candidates, found, len(known))
            continue
        is_compared = False
        entered = _with_steps(r, candidates, found, steps, len(known), rivals)
        if entered is None:
            refused.add(steps[0].candidate.label)
            earlier = verdict
            continue
        found, dropped = eliminated(r, entered, len(known))
        refused.update(dropped)
    last = _findings(r, kept, found, verdict, judged)
    return (better and better(last)) or last


def _hiding(r: Responses, model: Model, verdict: Verdict, judged: _Judge, most: int) -> npt.NDArray[np.intp]:
    """Return the poses that hide an effect: outliers beside it, without which it passes; else none."""
    first = likeliest(r, model, verdict)
    if first is None or verdict.passes:
        return np.empty(0, dtype=np.intp)
    apart = outliers(r, [*model.accepted, first.candidate], most)
    others = np.delete(np.arange(len(r)), apart)
    if len(apart):
        fewer = replace(judged, candidates=[c.rows(others) for c in judged.candidates], drawn={})
        if fewer(fitted_model(r.rows(others), [c.rows(others) for c in model.accepted])).passes:
            return apart
    return apart[:0]


def _findings(
    r: Responses,
    kept: npt.NDArray[np.intp],
    found: Sequence[SelectedEffect],
    verdict: Verdict,
    judged: _Judge,
) -> Findings:
    model = fitted_model(r, [f.candidate for f in found])
    return Findings(r, kept, tuple(found), model.fitted, model.columns, verdict.least_p_value, judged.drawn)


def _with_steps(
    r: Responses,
    candidates: Sequence[Candidate],
    found: list[SelectedEffect],
    steps: Sequence[SelectedEffect],
    known: int,
    rivals: Rivals | None,
) -> list[SelectedEffect] | None:
    """Return the effects with those that enter, all reselected; None where they cannot be true together."""
    fresh = steps[0] if rivals is not None and len(steps) == 1 else None
    entered = reselected(r, candidates, [*found, *steps], known, rivals, fresh=fresh, thorough=False)
    entered = with_known_places(r, candidates, with_families(r, entered, known))
    return admitted(r, found, entered, known) if found else entered


def _compared(
    r: Responses, candidates: Sequence[Candidate], found: list[SelectedEffect], known: int
) -> tuple[list[SelectedEffect], bool]:
    """Return the effects, each compared thoroughly, or as they were if those cannot be true together.

    And whether they stay what they were compared as: none has moved to a known place or become a harmonic.
    """
    again = reselected(r, candidates, found, known)
    if again and is_admissible(r, [f.candidate for f in again]):
        found = eliminated(r, again, known)[0]
    families = with_families(r, found, known)
    placed = with_known_places(r, candidates, families)
    forms, before = ([f.candidate.shape.form for f in those] for those in (families, found))
    return placed, placed is families and forms == before


def _is_full(r: Responses, accepted: Sequence[Candidate], known: int, most: int) -> bool:
    """Return whether a model has the most causes, the known ones not counted."""
    own = accepted[known:]
    if not own:
        return False
    alone = [c for c in own if not c.shape.series]
    series = {c.shape.series for c in own if c.shape.series and not any(is_term_of(c, o) for o in own)}
    firsts = sum(not any(term_alike(r, other, c) for other in alone) for c in alone)
    columns = sum(c.columns.shape[2] for c in accepted)
    return len(series) + firsts >= most or columns > MOST_COLUMNS * len(r)
