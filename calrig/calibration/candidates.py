"""Everything a search considers for given poses, and how a found effect is rebuilt in any poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calrig.calibration.effect import HIDDEN, Effect, Parameters, Shape
from calrig.calibration.effects import EFFECTS, UNNAMED, effect_of
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

LEAST_TURN_DEG = 330.0
"""Poses over such an arc go round: the orders of a turn come apart."""
MOST_COLUMNS = 0.2
"""To a pose, of a series offered as one: more of them explain any poses at all."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One shape of an effect in one set of poses.

    Attributes:
        columns: (n, J, p).
        beside: another one whose columns come first, where both are considered as one.
        label: the name, for an unnamed shape with its covariate: what two forms of one thing share.
        parameters: how many it adds to a model: coefficients, and one or two for a place that was scanned.
            One of n instants costs 2·log n in −2 log likelihood, twice a coefficient's log n (Zhang &
            Siegmund, Biometrics 63, 2007, for change points); a place that a likelihood is smooth in costs
            log n.
    """

    effect: Effect
    shape: Shape
    columns: FloatArray
    beside: Candidate | None = None
    label: str = field(init=False)
    parameters: int = field(init=False)

    def __post_init__(self) -> None:
        shapes = [self.shape, *([] if self.beside is None else [self.beside.shape])]
        scanned = sum(s.place_cost for s in shapes if s.scanned)
        replaced = sum(s.replaces is not None for s in shapes)
        own = self.name if self.named else f"{UNNAMED} {self.covariate}"
        label = own if self.beside is None else f"{self.beside.label} + {own}"
        object.__setattr__(self, "label", label)
        object.__setattr__(self, "parameters", int(self.columns.shape[2]) + scanned - replaced)

    @property
    def members(self) -> tuple[Candidate, ...]:
        """The effects it is made of, each by itself."""
        if self.beside is None:
            return (self,)
        width = self.beside.columns.shape[2]
        return *self.beside.members, Candidate(self.effect, self.shape, self.columns[:, :, width:])

    def is_possible(self, beta: FloatArray) -> bool:
        """Whether the coefficients (≥ p,), its own first, are any that physics allows."""
        first = 0
        for one in self.members:
            width = one.columns.shape[2]
            if not one.effect.possible(one.shape, beta[first : first + width]):
                return False
            first += width
        return True

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

    def rows(self, chosen: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Candidate:
        """The same candidate in some of the poses."""
        beside = self.beside and self.beside.rows(chosen)
        return Candidate(self.effect, self.shape, self.columns[chosen], beside)


def candidate_of(r: Responses, effect: Effect, shape: Shape) -> Candidate:
    """A shape with its columns."""
    return Candidate(effect, shape, r.columns(shape.shares))


def candidates_of(r: Responses) -> list[Candidate]:
    """Every candidate that these poses can show, those without a name last."""
    effects = sorted(EFFECTS.values(), key=lambda effect: effect.name == UNNAMED)
    found = [candidate_of(r, effect, shape) for effect in effects for shape in effect.shapes(r)]
    shown = [candidate for candidate in found if np.ptp(candidate.columns[:, 0, 0]) > 0.0]
    pairs = [(a, b) for b in shown for a in shown if a.name in b.effect.together_with]
    together = [
        Candidate(b.effect, b.shape, np.concatenate([a.columns, b.columns], axis=2), a) for a, b in pairs
    ]
    together += _series(r, shown)
    unnamed = sum(not candidate.named for candidate in shown)
    return [*shown[: len(shown) - unnamed], *together, *shown[len(shown) - unnamed :]]


def _series(r: Responses, shown: Sequence[Candidate]) -> list[Candidate]:
    """The first terms of the turn's series as one, so many and more: each alone may look like noise."""
    if np.ptp(r.theta_deg) < LEAST_TURN_DEG:
        return []
    joined: list[Candidate] = []
    for term in (c for c in shown if c.shape.series and not c.shape.scanned):
        before = joined[-1] if joined else None
        columns = term.columns if before is None else np.concatenate([before.columns, term.columns], axis=2)
        joined.append(Candidate(term.effect, term.shape, columns, before))
    return [c for c in joined[1:] if c.columns.shape[2] <= MOST_COLUMNS * len(r)]


def rebuilt(candidate: Candidate, r: Responses, form: str | None = None) -> Candidate | None:
    """The same form of the same effect in other poses; None where they cannot show it.

    Args:
        candidate: as it was found, elsewhere.
        r: the poses to rebuild it in.
        form: another form of it.
    """
    wanted = candidate.shape.form if form is None else form
    forms = [
        shape
        for shape in candidate.effect.forms(r, candidate.shape.at)
        if shape.form == wanted and shape.covariate == candidate.shape.covariate
    ]
    nearest = _nearest(forms, candidate.shape.at)
    return candidate_of(r, candidate.effect, nearest[0]) if nearest else None


def documented_forms(r: Responses, name: str, covariate: str, parameters: Parameters) -> list[Candidate]:
    """The forms that an effect of a document may have had: those with all its parameters, at its places.

    Args:
        r: any poses.
        name: of the effect.
        covariate: that the document has it follow.
        parameters: values of those that are known.

    Returns:
        None of them where these poses cannot show it.
    """
    effect = effect_of(name)
    shapes = [
        shape
        for shape in effect.forms(r, parameters)
        if (shape.covariate or effect.covariate.name) == covariate and shape.stated <= set(parameters)
    ]
    widest = max((len(shape.stated) for shape in shapes), default=0)
    whole = [shape for shape in shapes if len(shape.stated) == widest]
    return [candidate_of(r, effect, shape) for shape in _nearest(whole, parameters)]


def _nearest(shapes: Sequence[Shape], wanted: Parameters) -> list[Shape]:
    """Those whose places lie nearest to the wanted ones."""

    def distance(shape: Shape) -> float:
        given = ((value, wanted.get(name)) for name, value in shape.at.items() if name not in HIDDEN)
        return math.fsum(abs(value - aim) for value, aim in given if aim is not None)

    least = min(map(distance, shapes), default=0.0)
    return [shape for shape in shapes if distance(shape) <= least + 1e-9]


def base_without(r: Responses, replaced: str | None) -> FloatArray:
    """The columns of bias and scale, less the one that a shape takes the place of."""
    if replaced is None:
        return r.base
    keep = [k for k, name in enumerate(r.base_names) if name != replaced]
    return np.asarray(r.base[:, :, keep], dtype=np.float64)
