"""Natural cubic splines: the basis that a search fits, and a fitted curve as a table of knots.

Between its knots such a curve is a cubic, at the end knots it has no curvature, and beyond them it is
straight. A document has the knots and the curve's values there, from which the whole curve follows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Self

import numpy as np

from calrig.calibration.regression.effect import Documents, Parameters
from calrig.calibration.regression.terms import c_literal
from calrig.estimation.angles import FloatArray

KNOT, VALUE = "knot_{}_deg", "curve_{}_deg"
"""Parameters of a curve of the angle in a document, each with the number of the knot from 0."""
FEWEST_KNOTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class NaturalSplines:
    """All natural cubic splines of one set of knots, as columns whose sums they are.

    Attributes:
        least, span: of the values that the curves go over.
        knots: (k,) ascending, 0 to 1 over these.
    """

    least: float
    span: float
    knots: FloatArray

    @classmethod
    def over(cls, z: FloatArray, pieces: int) -> Self:
        """Return those over values (m,), with knots at their quantiles."""
        least, span = float(z.min()), float(np.ptp(z))
        return cls(least, span, np.unique(np.quantile((z - least) / span, np.linspace(0.0, 1.0, pieces + 1))))

    def __call__(self, z: FloatArray) -> FloatArray:
        """Return (n, ≤ pieces) basis at values (n,), no constant in it."""
        return _basis((z - self.least) / self.span, self.knots)

    @property
    def at(self) -> FloatArray:
        """The knots (k,) in the unit of the values; the outer ones are their ends."""
        return np.asarray(self.least + self.span * self.knots, dtype=np.float64)


def natural_spline(z: FloatArray, pieces: int) -> FloatArray:
    """Return (n, ≤ pieces) basis of the natural cubic splines with knots at quantiles, no constant in it."""
    return NaturalSplines.over(z, pieces)(z)


def _basis(u: FloatArray, knots: FloatArray) -> FloatArray:
    """Hastie, Tibshirani & Friedman, The Elements of Statistical Learning, equations 5.4 and 5.5."""
    if len(knots) < FEWEST_KNOTS:
        return np.asarray(u[:, None], dtype=np.float64)
    bends = np.maximum(u[:, None] - knots, 0.0) ** 3
    bends = (bends[:, :-1] - bends[:, -1:]) / (knots[-1] - knots[:-1])
    return np.column_stack([u, bends[:, :-1] - bends[:, -1:]])


def curve_document(
    knots: FloatArray, columns: FloatArray, beta: FloatArray, covariance: FloatArray
) -> Documents:
    """Return knots and the values there, with standard errors, of the curve with coefficients beta (p,).

    `knots` (k,) and `columns` (n, p) are of the basis, `covariance` (p, p) of the coefficients.
    """
    columns = bent_columns(columns, knots)
    variance = np.einsum("ki,ij,kj->k", columns, covariance, columns)
    document: Documents = {}
    for k, (knot, value, square) in enumerate(zip(knots, columns @ beta, variance, strict=True)):
        document[KNOT.format(k)] = {"value": float(knot), "std": None}
        document[VALUE.format(k)] = {"value": float(value), "std": math.sqrt(max(float(square), 0.0))}
    return document


def bent_columns(columns: FloatArray, knots: FloatArray | None = None) -> FloatArray:
    """Return columns (n, p) of the basis without their straight lines over the poses: bias and scale.

    With `knots` (k,) they are wanted there instead of in the poses: (k, p).
    """
    u = columns[:, 0]
    lines = np.linalg.lstsq(np.column_stack([np.ones_like(u), u]), columns, rcond=None)[0]
    there = columns if knots is None else _basis(_unit(knots), _unit(knots))
    return np.asarray(there - np.column_stack([np.ones(len(there)), there[:, 0]]) @ lines)


def _unit(knots: FloatArray) -> FloatArray:
    return np.asarray((knots - knots[0]) / (knots[-1] - knots[0]), dtype=np.float64)


def _numbered(parameters: Parameters, name: str) -> FloatArray:
    numbered = (parameters.get(name.format(k)) for k in count())
    found: list[float] = []
    for value in numbered:
        if value is None:
            break
        found.append(value)
    return np.array(found, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SplineCurve:
    """A natural cubic spline by its knots.

    Attributes:
        knots: (k,) ascending.
        values: (k,) of the curve at its knots.
        bends: (k,) its second derivative there; 0 at both ends.
    """

    knots: FloatArray
    values: FloatArray
    bends: FloatArray

    @classmethod
    def of(cls, parameters: Parameters) -> Self | None:
        """Return the curve that a document's parameters state; None where they state none."""
        knots, values = _numbered(parameters, KNOT), _numbered(parameters, VALUE)
        if len(knots) < FEWEST_KNOTS or len(values) != len(knots) or (np.diff(knots) <= 0.0).any():
            return None
        return cls(knots, values, _bends(knots, values))

    def __call__(self, at: FloatArray) -> FloatArray:
        """Return (n,) the curve at some places, straight beyond its ends."""
        inside = np.clip(at, self.knots[0], self.knots[-1])
        piece = np.clip(np.searchsorted(self.knots, inside, side="right") - 1, 0, len(self.knots) - 2)
        x = inside - self.knots[piece]
        value, slope, square, cube = (part[piece] for part in self._pieces())
        beyond = at - inside
        end_slope = slope + x * (2.0 * square + 3.0 * x * cube)
        return np.asarray(value + x * (slope + x * (square + x * cube)) + beyond * end_slope)

    def in_c(self) -> str:
        """Return a C expression of `theta`: the cubic of the piece that it lies in, from its lower knot."""
        pieces = np.column_stack(self._pieces())
        width = self.knots[-1] - self.knots[-2]
        value, slope, square, cube = pieces[-1]
        end_value = value + width * (slope + width * (square + width * cube))
        end_slope = slope + width * (2.0 * square + 3.0 * width * cube)
        ranges: list[tuple[float, Sequence[float]]] = [(self.knots[0], (*pieces[0, :2], 0.0, 0.0))]
        ranges += list(zip(self.knots[:-1], pieces, strict=True))
        ranges.append((self.knots[-1], (end_value, end_slope, 0.0, 0.0)))
        ends = [*self.knots, None]
        text = ""
        for (knot, coefficients), end in zip(ranges, ends, strict=True):
            cubic = _cubic_in_c(float(knot), [float(one) for one in coefficients])
            text += cubic if end is None else f"theta < {c_literal(float(end))} ? {cubic} : "
        return f"({text})"

    def _pieces(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return (k − 1,) coefficients of 1, x, x² and x³ of each piece, x counted from its lower knot."""
        width, rise = np.diff(self.knots), np.diff(self.values)
        slope = rise / width - width * (2.0 * self.bends[:-1] + self.bends[1:]) / 6.0
        return self.values[:-1], slope, self.bends[:-1] / 2.0, np.diff(self.bends) / (6.0 * width)


def _cubic_in_c(knot: float, coefficients: Sequence[float]) -> str:
    value, slope, square, cube = map(c_literal, coefficients)
    x = f"(theta - {c_literal(knot)})"
    if not any(coefficients[2:]):
        return f"{value} + {slope} * {x}"
    return f"{value} + {x} * ({slope} + {x} * ({square} + {x} * {cube}))"


def _bends(knots: FloatArray, values: FloatArray) -> FloatArray:
    """Return (k,) second derivatives for which the slope is continuous at every inner knot."""
    width = np.diff(knots)
    slopes = np.diff(values) / width
    inner = (
        np.diag((width[:-1] + width[1:]) / 3.0)
        + np.diag(width[1:-1] / 6.0, 1)
        + np.diag(width[1:-1] / 6.0, -1)
    )
    return np.concatenate([[0.0], np.linalg.solve(inner, np.diff(slopes)), [0.0]])
