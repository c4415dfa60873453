"""Everything a search considers for given poses: each form of each effect, and the shapes without a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.effects import CATALOGUE, Effect, Shape
from calrig.calibration.responses import Responses
from calrig.calibration.shapes import UNNAMED, unnamed_shapes
from calrig.estimation.angles import FloatArray

SCANNED = ("period_deg", "pose", "period")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One shape in one set of poses.

    Attributes:
        effect: its catalogue entry, None for a shape without a name.
        covariate: what it is a function of.
        columns: (n, J, p).
        family: candidates whose maximum is judged together, so that a scan of a hundred periods does not
            raise the bar for an effect of one parameter.
    """

    effect: Effect | None
    covariate: str
    shape: Shape
    columns: FloatArray
    family: str

    @property
    def name(self) -> str:
        """Its name in the catalogue, or `unnamed`."""
        return UNNAMED if self.effect is None else self.effect.name

    @property
    def label(self) -> str:
        """The name, for an unnamed shape with its covariate: what two forms of one thing share."""
        return self.name if self.effect is not None else f"{UNNAMED} {self.covariate}"

    @property
    def parameters(self) -> int:
        """How many parameters it adds to a model: coefficients, and two for a place that was scanned.

        One of n places costs 2·log n in −2 log likelihood, twice a coefficient's log n (Zhang & Siegmund,
        Biometrics 63, 2007, for change points).
        """
        scanned = any(key in self.shape.at for key in SCANNED) or self.shape.form.startswith(("kink", "step"))
        taken_over = 1 if self.shape.replaces else 0
        return int(self.columns.shape[2]) + (2 if scanned else 0) - taken_over

    def rows(self, chosen: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Candidate:
        """The same candidate in some of the poses."""
        return Candidate(self.effect, self.covariate, self.shape, self.columns[chosen], self.family)


def candidates_of(r: Responses) -> list[Candidate]:
    """Every candidate that these poses can show."""
    found = [
        Candidate(effect, effect.covariate, shape, r.columns(shape.shares), _family(effect.name, shape))
        for effect in CATALOGUE
        for shape in effect.shapes(r)
    ]
    found += [
        Candidate(None, covariate, shape, r.columns(shape.shares), f"{UNNAMED} {covariate} {_kind(shape)}")
        for covariate, shape in unnamed_shapes(r)
    ]
    return [candidate for candidate in found if np.ptp(candidate.columns[:, 0, 0]) > 0.0]


def _family(name: str, shape: Shape) -> str:
    return name if any(key in shape.at for key in SCANNED) else "single"


def _kind(shape: Shape) -> str:
    return "cycle" if shape.form == "cycle" else ""


def base_without(r: Responses, replaced: str | None) -> FloatArray:
    """The columns of bias and scale, less the one that a shape takes the place of."""
    if replaced is None:
        return r.base
    keep = [k for k, name in enumerate(r.base_names) if name != replaced]
    return np.asarray(r.base[:, :, keep], dtype=np.float64)
