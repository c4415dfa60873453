"""Candidate effects of given poses, their columns in a model, and an effect rebuilt in other poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, reduce
from itertools import accumulate, combinations

import numpy as np

from calrig.calibration.effects import EFFECTS, UNNAMED, effect_of
from calrig.calibration.effects.unnamed import WAVE_BY_SIDE, few_places, waves_by_side
from calrig.calibration.regression.channels import ANGLE, READING
from calrig.calibration.regression.effect import APPROACH, ELEVATION, HIDDEN, OF, Effect, Parameters, Shape
from calrig.calibration.regression.responses import Change, Responses
from calrig.calibration.regression.run_changes import (
    MANY_CHANGES,
    RUN,
    SOME_CHANGES,
    changed_shapes,
    in_words,
    shapes_of,
    since,
)
from calrig.calibration.regression.terms import THE_TURN, goes_round
from calrig.estimation.angles import FloatArray

MOST_COLUMNS = 0.2
"""To a pose, of a series offered as one: more of them explain any poses at all."""
CHOICE_OF_RUNS = 2
"""Parameters that it counts as, to choose the runs that have an effect."""
KEPT = 32
"""Effects whose further terms a search may ask for again."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One shape of an effect in one set of poses.

    Attributes:
        columns: (n, J, p).
        beside: another one whose columns come first, where both are considered as one.
        kind: the name, for an unnamed shape with its covariate: what it is, whenever it came.
        label: the kind, and between which runs it changed: what two forms of one thing share.
        several: the effects it is made of, each by itself; empty of one.
        parameters: how many it adds to a model: coefficients, and one or two for a place that was scanned.
            One of n instants costs 2·log n in −2 log likelihood, twice a coefficient's log n (Zhang &
            Siegmund, Biometrics 63, 2007, for change points), and so does the choice of the runs that have
            an effect; a place that a likelihood is smooth in costs log n.
    """

    effect: Effect
    shape: Shape
    columns: FloatArray
    beside: Candidate | None = None
    kind: str = field(init=False)
    label: str = field(init=False)
    several: tuple[Candidate, ...] = field(init=False)
    parameters: int = field(init=False)

    def __post_init__(self) -> None:
        kind = self.name if self.named else f"{UNNAMED} {self.covariate}"
        label = f"{kind}{in_words(self.changed)}"
        before = 0 if self.beside is None else self.beside.columns.shape[2]
        parameters = self.columns.shape[2] - before + (self.shape.place_cost if self.shape.scanned else 0)
        parameters -= self.shape.replaces is not None
        if self.changed is not None and not _is_level(self.columns[:, :, before:]):
            parameters += CHOICE_OF_RUNS
        if self.beside is not None:
            kind, label = f"{self.beside.kind} + {kind}", f"{self.beside.label} + {label}"
            parameters += self.beside.parameters
            if self.changed is not None and self.beside.beside is not None:
                label = f"{self.name} between all runs"
        members: tuple[Candidate, ...] = ()
        if self.beside is not None:
            alone = Candidate(self.effect, self.shape, self.columns[:, :, before:])
            members = (*self.beside.members, alone)
        object.__setattr__(self, "several", members)
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "label", label)
        object.__setattr__(self, "parameters", parameters)

    @property
    def members(self) -> tuple[Candidate, ...]:
        """The effects it is made of, each by itself."""
        return self.several or (self,)

    def is_possible(self, beta: FloatArray) -> bool:
        """Return whether the coefficients (≥ p,), its own first, are any that physics allows."""
        first = 0
        if self.beside is not None:
            first = self.beside.columns.shape[2]
            if not self.beside.is_possible(beta):
                return False
        own = beta[first : self.columns.shape[2]]
        if self.effect.possible(self.shape, own):
            return True
        # of a difference either sign: what a parameter may not be by itself, it may have lost
        return self.changed is not None and self.effect.possible(self.shape, -own)

    @property
    def follows(self) -> str | None:
        """The effect that has to be in the model before it is offered by itself."""
        return self.effect.follows or self.shape.follows

    @property
    def name(self) -> str:
        """Its name in the catalogue, or `unnamed`."""
        return self.effect.name

    @property
    def named(self) -> bool:
        """Whether it is an effect of the catalogue."""
        return self.effect.name != UNNAMED

    @property
    def covariate(self) -> str:
        """What it is a function of."""
        return self.shape.covariate or self.effect.covariate.name

    @property
    def changed(self) -> Change | None:
        """Between which runs, where it is only in the later ones."""
        return self.shape.changed

    def is_of_sensor(self, r: Responses) -> bool:
        """Return whether it is the sensor's only because the reference of these poses is good."""
        return self.effect.is_of_sensor(self.covariate, reference_is_good=r.reference_is_good)

    def is_smooth_of_sensor(self, r: Responses) -> bool:
        """Return whether it is a smooth or periodic term of the angle that belongs to the sensor."""
        if self.covariate != ELEVATION.name or not r.reference_is_good:
            return False
        return (
            bool(self.shape.knots) if not self.named else self.is_of_sensor(r) or self.effect.scope == "unit"
        )

    def is_distinct(self, r: Responses, other: Candidate) -> bool:
        """Whether both can be in one model: in other runs, or at places that these poses tell apart."""
        return distinct_from(r, [other])(self)

    def rows(self, chosen: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Candidate:
        """Return the same candidate in some of the poses."""
        beside = self.beside and self.beside.rows(chosen)
        return Candidate(self.effect, self.shape, self.columns[chosen], beside)


def distinct_from(r: Responses, others: Sequence[Candidate]) -> Callable[[Candidate], bool]:
    """Return what tells whether a candidate can be in one model with each of several others."""
    places: dict[tuple[object, str], list[float]] = {}

    def is_distinct(candidate: Candidate) -> bool:
        resolved, change = candidate.effect.resolved, in_words(candidate.changed)
        if resolved is None:
            return True
        if (resolved, change) not in places:
            alike = [other for other in others if in_words(other.changed) == change]
            places[resolved, change] = [resolved(r, other.shape) for other in alike]
        here = resolved(r, candidate.shape)
        return not any(abs(here - there) < 1.0 for there in places[resolved, change])

    return is_distinct


def _is_level(columns: FloatArray) -> bool:
    """Return whether the reading columns take at most two values: a constant offset in some poses."""
    return len(np.unique(columns[:, 0])) <= 2


def candidate_of(r: Responses, effect: Effect, shape: Shape) -> Candidate:
    """Return a shape with its columns."""
    return Candidate(effect, shape, r.columns(shape.shares))


def candidate_at(r: Responses, candidate: Candidate, shape: Shape) -> Candidate:
    """Another shape of a candidate's effect, with a change between the same runs."""
    (here,) = changed_shapes(r, candidate.changed, [shape])
    return candidate_of(r, candidate.effect, here)


def shares_at(r: Responses, candidate: Candidate, theta_deg: FloatArray) -> FloatArray:
    """Return (n, p) of what a function of the elevation adds to readings that stand for elevations (n,)."""
    at_elevation, changed = candidate.shape.at_elevation, candidate.changed
    assert at_elevation is not None  # noqa: S101 (the caller chose it by that)
    shares = at_elevation(theta_deg).reshape(len(r), -1)
    return shares if changed is None else shares * since(r, changed)[:, None]


def at_its_elevations(r: Responses, candidate: Candidate) -> Candidate:
    """Return a candidate as readings have it that are late: at the elevations that they stand for."""
    if candidate.beside is None and candidate.effect.on_vector_g is not None:
        return rebuilt(candidate, r) or candidate
    beside = candidate.beside and at_its_elevations(r, candidate.beside)
    columns = candidate.columns
    before = 0 if beside is None else beside.columns.shape[2]
    if beside is not None or candidate.shape.at_elevation is not None:
        columns = columns.copy()
    if beside is not None:
        columns[:, :, :before] = beside.columns
    if candidate.shape.at_elevation is not None:
        late = [r.channels.index(name) for name in (READING, ANGLE) if name in r.channels]
        columns[:, late, before:] = shares_at(r, candidate, r.theta_deg)[:, None]
    if columns is candidate.columns:
        return candidate
    return Candidate(candidate.effect, candidate.shape, columns, beside)


def candidates_of(r: Responses) -> list[Candidate]:
    """Return every candidate that these poses can show, those without a name last.

    Of two that fit alike the first leads: of a sensor that shows no accelerometer, not that of its axes.
    """
    has_axes = ANGLE in r.channels or not r.reference_is_good
    effects = sorted(
        EFFECTS.values(), key=lambda e: (e.name == UNNAMED, e.on_vector_g is not None and not has_axes)
    )
    found = [
        candidate_of(r, effect, shape)
        for effect in effects
        for shape in shapes_of(r, effect, named=effect.name != UNNAMED)
    ]
    shown = [candidate for candidate in found if np.ptp(candidate.columns[:, 0, 0]) > 0.0]
    all_along = [candidate for candidate in shown if candidate.changed is None]
    with_others = [c for c in all_along if c.effect.together_with and not c.shape.alone]
    pairs = [(a, b) for b in with_others for a in all_along if a.name in b.effect.together_with]
    if few_places(r.theta_deg) is None:  # there each place may have its own hysteresis
        by_side = [c for c in all_along if c.shape.beside == (APPROACH.name,)]
        pairs += [(a, b) for b in by_side for a in all_along if a.effect.covariate is APPROACH]
    together = [_together(a, b) for a, b in pairs] + _several_changes(shown, len(r.run_ids) - 1)
    together += _series(r, all_along)
    unnamed = sum(not candidate.named for candidate in shown)
    return [*shown[: len(shown) - unnamed], *together, *shown[len(shown) - unnamed :]]


def companions_of(accepted: Sequence[Candidate]) -> set[str]:
    """Return names of the effects that are declared to come together with some of those in a model."""
    present = {c.name for c in accepted}
    asked = {name for c in accepted for name in c.effect.together_with}
    return asked | {name for name, effect in EFFECTS.items() if present.intersection(effect.together_with)}


def _together(a: Candidate, b: Candidate) -> Candidate:
    return Candidate(b.effect, b.shape, np.concatenate([a.columns, b.columns], axis=2), a)


def _series(r: Responses, shown: Sequence[Candidate]) -> list[Candidate]:
    """The first terms of each series as one, so many and more: each alone may look like noise.

    Orders of the turn only where the poses go round.
    """
    joined: list[Candidate] = []
    terms = [c for c in shown if c.shape.series and not c.shape.scanned]
    for series in dict.fromkeys(c.shape.series for c in terms):
        if series != THE_TURN or goes_round(r):
            joined += list(accumulate((c for c in terms if c.shape.series == series), _together))[1:]
    return [c for c in joined if c.columns.shape[2] <= MOST_COLUMNS * len(r)]


def harmonics_of(r: Responses, accepted: Sequence[Candidate]) -> list[Candidate]:
    """Return the further terms of causes in a model, each and the first of them as one.

    And what each wave may differ by from one direction to the other.
    """
    found, is_distinct = [], distinct_from(r, accepted)
    known = {c.shape.at.get("period") for c in accepted if c.shape.form == WAVE_BY_SIDE}
    for first in accepted:
        if first.changed is None:
            terms = [c for c in _further_terms(r, first) if is_distinct(c)]
            by_side = [c for c in _by_side(r, first) if c.shape.at["period"] not in known]
            found += [*terms, *_series(r, terms), *by_side]
    return found


def term_alike(r: Responses, first: Candidate, other: Candidate) -> Candidate | None:
    """Return the further term of a cause, as of a worm, that these poses do not tell from another effect."""
    if other is first or other.label != first.label or first.beside or first.changed:
        return None
    place = first.effect.place
    alike = [term for term in _further_terms(r, first) if not term.is_distinct(r, other)]
    return min(alike, key=lambda term: abs(term.shape.at[place] - other.shape.at[place]), default=None)


def is_term_of(term: Candidate, first: Candidate) -> bool:
    """Return whether a candidate is a further term of another one, at a place that moves with it."""
    there = term.shape.at.get(OF)
    is_another = term is not first and term.label == first.label
    return is_another and there is not None and there == first.shape.at[first.effect.place]


@lru_cache(maxsize=KEPT)
def _further_terms(r: Responses, first: Candidate) -> list[Candidate]:
    return [
        candidate_of(r, first.effect, shape)
        for at in first.effect.harmonics(r, first.shape)
        for shape in first.effect.forms(r, at)
        if first.effect.carried(r, shape)
    ]


@lru_cache(maxsize=KEPT)
def _by_side(r: Responses, wave: Candidate) -> list[Candidate]:
    period_deg = wave.shape.at.get("period_deg")
    if period_deg is None:
        return []
    return [candidate_of(r, EFFECTS[UNNAMED], shape) for shape in waves_by_side(r, period_deg)]


def orders_beside(
    r: Responses, candidates: Sequence[Candidate], accepted: Sequence[Candidate]
) -> list[Candidate]:
    """Return the first orders of the turn beside those in a model as one, so many and more.

    Where none is in it, the candidates have them.
    """
    if not any(c.shape.series == THE_TURN for c in accepted) or not goes_round(r):
        return []
    orders = [c for c in candidates if c.shape.series == THE_TURN and c.beside is None and c.changed is None]
    present = {c.label for c in accepted if not c.shape.at}
    is_distinct = distinct_from(r, accepted)
    left = [c for c in orders if c.label not in present and is_distinct(c)]
    return _series(r, left)


def is_order_beside(candidate: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Return whether a candidate is several orders of the turn as one, beside others in a model."""
    is_several = candidate.beside is not None and candidate.shape.series == THE_TURN
    return is_several and any(c.shape.series == THE_TURN for c in accepted)


def _several_changes(shown: Sequence[Candidate], changes: int) -> list[Candidate]:
    """A level that changes and comes back, or changes between all runs: each change alone explains little.

    Two at a time as in circular binary segmentation (Olshen, Venkatraman, Lucito & Wigler, Biostatistics 5,
    2004).
    """
    found = []
    for effect in {c.effect.name: c.effect for c in shown if c.effect.covariate is RUN}.values():
        own = [c for c in shown if c.effect is effect]  # in the order of the runs
        if 2 <= changes <= SOME_CHANGES:
            found += [_together(a, b) for a, b in combinations(own, 2)]
        if 3 <= changes <= MANY_CHANGES:
            found.append(reduce(_together, own))
    return found


def rebuilt(candidate: Candidate, r: Responses, form: str | None = None) -> Candidate | None:
    """Return the same effect in the same form, or another `form`, in other poses; None if they lack it.

    What was one with another thing in its own poses may have further parameters in others, and what stood
    alone there may be a part of the whole: `coefficients_in` says what its coefficients are in them.
    """
    beside = None if candidate.beside is None else rebuilt(candidate.beside, r)
    if candidate.beside is not None and beside is None:
        return None
    shapes = changed_shapes(r, candidate.changed, list(candidate.effect.forms(r, candidate.shape.at)))
    for wanted in (candidate.shape.form, candidate.shape.part_of) if form is None else (form,):
        forms = [s for s in shapes if s.form == wanted and s.covariate == candidate.shape.covariate]
        if form is None:
            forms = [s for s in forms if {*candidate.shape.parameters} <= {*s.parameters}]
        nearest = _nearest(forms, candidate.shape.at)
        if nearest:
            own = candidate_of(r, candidate.effect, nearest[0])
            return own if beside is None else _together(beside, own)
    return None


def coefficients_in(there: Candidate, found: Candidate, beta: FloatArray) -> FloatArray | None:
    """Return (q,) what coefficients (p,) of a candidate are where it was rebuilt in other poses.

    A parameter that the poses it was found in did not show is 0. None where a column has another meaning.
    """
    own: list[FloatArray] = []
    first = 0
    for one, other in zip(found.members, there.members, strict=True):
        width, wide = one.columns.shape[2], other.columns.shape[2]
        names, wanted = one.shape.parameters, other.shape.parameters
        sizes, first = beta[first : first + width], first + width
        if names != wanted:
            if len(names) != width or len(wanted) != wide or not {*names} <= {*wanted}:
                return None
            known = dict(zip(names, sizes, strict=True))
            sizes = np.array([known.get(name, 0.0) for name in wanted])
        elif width != wide:  # a curve of other knots
            return None
        own.append(sizes)
    return np.concatenate(own)


def documented_forms(
    r: Responses, name: str, covariate: str, parameters: Parameters, changed: Change | None = None
) -> list[Candidate]:
    """The forms that an effect of a document may have had: those with all its parameters, at its places.

    Args:
        r: any poses.
        name: of the effect.
        covariate: that the document has it follow.
        parameters: values of those that are known.
        changed: between which runs, where it is a difference.

    Returns:
        None of them where these poses cannot show it.
    """
    effect = effect_of(name)
    forms = list(effect.forms(r, parameters))
    # the difference is the same whether something began, or what there was before ended
    changes = [changed] if changed is None else [replace(changed, ended=ended) for ended in (False, True)]
    shapes = [
        shape
        for change in changes
        for shape in changed_shapes(r, change, forms)
        if (shape.covariate or effect.covariate.name) == covariate and shape.stated <= set(parameters)
    ]
    widest = max((len(shape.stated) for shape in shapes), default=0)
    whole = [shape for shape in shapes if len(shape.stated) == widest]
    return [candidate_of(r, effect, shape) for shape in _nearest(whole, parameters)]


def _nearest(shapes: Sequence[Shape], wanted: Parameters) -> list[Shape]:
    def distance(shape: Shape) -> float:
        given = ((value, wanted.get(name)) for name, value in shape.at.items() if name not in HIDDEN)
        return math.fsum(abs(value - aim) for value, aim in given if aim is not None)

    least = min(map(distance, shapes), default=0.0)
    return [shape for shape in shapes if distance(shape) <= least + 1e-9]


def base_without(r: Responses, replaced: str | None) -> FloatArray:
    """Return the columns of bias and scale, less the one that a shape takes the place of."""
    if replaced is None:
        return r.base
    keep = [k for k, name in enumerate(r.base_names) if name != replaced]
    return np.asarray(r.base[:, :, keep], dtype=np.float64)


def model_columns(r: Responses, accepted: Sequence[Candidate]) -> FloatArray:
    """Return (n, J, p) columns of bias and scale, then of the accepted candidates in their order."""
    return np.concatenate([base_without(r, replaced(accepted)), *[c.columns for c in accepted]], axis=2)


def replaced(accepted: Sequence[Candidate]) -> str | None:
    """Return the base column that one of the candidates takes the place of."""
    return next((c.shape.replaces for c in accepted if c.shape.replaces), None)


def own_columns(columns: FloatArray, accepted: Sequence[Candidate]) -> list[slice]:
    """Return where each accepted candidate's own columns lie among those of `model_columns`."""
    ends = np.cumsum([c.columns.shape[2] for c in accepted])
    base = columns.shape[2] - int(ends[-1]) if accepted else 0
    return [
        slice(base + int(end) - c.columns.shape[2], base + int(end))
        for c, end in zip(accepted, ends, strict=True)
    ]


def side_by_side(models: Sequence[FloatArray]) -> FloatArray:
    """Return (m, n, J, p) of models (n, J, ≤ p); narrower ones end in zeros."""
    width = max(columns.shape[2] for columns in models)
    padded = np.zeros((len(models), *models[0].shape[:2], width))
    for k, columns in enumerate(models):
        padded[k, :, :, : columns.shape[2]] = columns
    return padded
