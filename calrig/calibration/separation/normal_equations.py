"""Normal equations in blocks, one a unit, that have nothing in common but a border, the stage's map.

Each block is taken out of the border (Schur's complement), so that a unit more costs as much as the one
before (Björck, Numerical Methods for Least Squares Problems, 1996, section 6.3; Helmert's blocking). Poses
whose noise follows on that of the pose before are made independent first.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calrig.estimation.angles import BoolArray, FloatArray, Intp


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Blocks of p parameters, and the border that all of them touch.

    Attributes:
        size: p.
        blocks: places (k,) of each, ascending; `inside` (k, k) and `across` (k, q), beside the border.
        border: places (q,), and `middle` (q, q).
    """

    size: int
    blocks: tuple[Intp, ...]
    inside: tuple[FloatArray, ...]
    across: tuple[FloatArray, ...]
    border: Intp
    middle: FloatArray


class Arrow(_Blocks):
    """A symmetric matrix, with 0 between any two blocks."""

    __slots__ = ()

    def plus(self, diagonal: FloatArray) -> Self:
        """The same and a diagonal (p,)."""
        inside = tuple(own + np.diag(diagonal[at]) for at, own in zip(self.blocks, self.inside, strict=True))
        return replace(self, inside=inside, middle=self.middle + np.diag(diagonal[self.border]))

    def times(self, right: FloatArray) -> FloatArray:
        """(p,) the matrix times (p,)."""
        found = np.zeros(self.size)
        found[self.border] = self.middle @ right[self.border]
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            found[at] = inside @ right[at] + across @ right[self.border]
            found[self.border] += across.T @ right[at]
        return found

    def whole(self) -> FloatArray:
        """(p, p)."""
        found = np.zeros((self.size, self.size))
        found[np.ix_(self.border, self.border)] = self.middle
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            found[np.ix_(at, at)] = inside
            found[np.ix_(at, self.border)] = across
            found[np.ix_(self.border, at)] = across.T
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Weighted normal equations about some parameters.

    Attributes:
        residuals: (n, c) measured less expected over the shape of the noise, g (a reading: rad, and 0).
        matrix: JᵀWJ; `gradient` (p,) JᵀWr; `squares` rᵀWr. W whitens correlated poses.
        log_variance: log of the determinant of the noise's correlation.
        derivatives: (n, c, k) of each pose by its unit and mount (`Problem.own`), then by the map.
    """

    residuals: FloatArray
    matrix: Arrow
    gradient: FloatArray
    squares: float
    log_variance: float
    derivatives: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Inverse(_Blocks):
    """Of an arrow; 0 of parameters in no block and not in the border.

    `inside` is the inverse of each block by itself, `across` that times what stands beside the block in the
    border, and `middle` the inverse in the border.

    Attributes:
        log_determinant: of the whole.
    """

    log_determinant: float

    def solve(self, right: FloatArray) -> FloatArray:
        """(p,) the inverse times (p,)."""
        ahead = right[self.border].copy()
        for at, across in zip(self.blocks, self.across, strict=True):
            ahead -= across.T @ right[at]
        found = np.zeros(self.size)
        found[self.border] = self.middle @ ahead
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            found[at] = inside @ right[at] - across @ found[self.border]
        return found

    def diagonal(self) -> FloatArray:
        """(p,)."""
        found = np.zeros(self.size)
        found[self.border] = np.diag(self.middle)
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            found[at] = np.diag(inside) + ((across @ self.middle) * across).sum(axis=1)
        return found

    def times_trace(self, matrix: Arrow) -> float:
        """The trace of the inverse times another arrow of the same blocks, whose border may be longer."""
        border = np.searchsorted(matrix.border, self.border)
        found = float((self.middle * matrix.middle[np.ix_(border, border)]).sum())
        for k, (inside, across) in enumerate(zip(self.inside, self.across, strict=True)):
            beside = across @ self.middle
            found += float(((inside + beside @ across.T) * matrix.inside[k]).sum())
            found -= 2.0 * float((beside * matrix.across[k][:, border]).sum())
        return found

    def between(self, rows: FloatArray) -> FloatArray:
        """(m, m) the inverse between rows (m, p), which may be of few blocks."""
        beside, found = rows[:, self.border].copy(), np.zeros((len(rows), len(rows)))
        block = np.full(self.size, -1)
        for k, at in enumerate(self.blocks):
            block[at] = k
        touched = block[rows.any(axis=0)]
        for k in np.unique(touched[touched >= 0]):
            own = rows[:, self.blocks[k]]
            beside -= own @ self.across[k]
            found += own @ self.inside[k] @ own.T
        return np.asarray(found + beside @ self.middle @ beside.T)

    def at(self, places: Intp) -> FloatArray:
        """(m, m) the inverse at some places (m,)."""
        return self.between((places[:, np.newaxis] == np.arange(self.size)).astype(np.float64))


def inverse_of(matrix: Arrow, free: BoolArray) -> Inverse:
    """The inverse of a positive definite arrow; scaled, so that units of measure do not matter.

    `free` (q,) is what of the border is inverted.
    """
    border, middle = matrix.border[free], matrix.middle[np.ix_(free, free)]
    edge = np.diag(middle).copy()
    inside, across, logarithm = [], [], 0.0
    for block, beyond in zip(matrix.inside, matrix.across, strict=True):
        own, more = _inverted(block)
        beside = beyond[:, free]
        part = own @ beside
        middle -= beside.T @ part
        inside.append(own)
        across.append(part)
        logarithm += more
    middle, more = _inverted(middle, edge)
    return Inverse(matrix.size, matrix.blocks, tuple(inside), tuple(across), border, middle, logarithm + more)


def _inverted(matrix: FloatArray, diagonal: FloatArray | None = None) -> tuple[FloatArray, float]:
    """Inverse and log of the determinant, scaled by a diagonal: its own without one."""
    scale = 1.0 / np.sqrt(np.diag(matrix) if diagonal is None else diagonal)
    scaled = matrix * np.outer(scale, scale)
    inverse = np.linalg.inv(scaled) * np.outer(scale, scale)
    logarithm = float(np.linalg.slogdet(scaled)[1]) - 2.0 * float(np.log(scale).sum())
    return 0.5 * (inverse + inverse.T), logarithm


def whitened(values: FloatArray, place: Intp, chain: Intp, rho: float) -> tuple[FloatArray, FloatArray]:
    """Values (m, …) less what the one before predicts, scaled to the same variance as they had.

    Args:
        values: of poses in the order measured.
        place: (m,) of each pose among those that were taken.
        chain: (m,) the run that each is of: its first pose follows on nothing.
        rho: the correlation from one pose to the next.

    Returns:
        (m, …) whitened, and (m,) log of the share of the variance that is each one's own.
    """
    if rho <= 0.0:
        return values, np.zeros(len(values))
    share = np.zeros(len(values))
    share[1:] = np.where(np.diff(chain) == 0, rho ** np.abs(np.diff(place)), 0.0)
    own = 1.0 - share**2
    across = (slice(None), *[None] * (values.ndim - 1))
    before = np.concatenate([values[:1], values[:-1]])
    return (values - share[across] * before) / np.sqrt(own)[across], np.log(own)
