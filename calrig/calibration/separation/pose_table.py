"""Poses of any number of mounts and units, as the joint solution takes them.

The inverse of a matrix whose blocks, one a unit, have nothing in common but a border, the stage's map.

Each block is taken out of the border (Schur's complement), so that a unit more costs as much as the one
before (Björck, Numerical Methods for Least Squares Problems, 1996, section 6.3; Helmert's blocking).

Poses whose noise follows on that of the pose before, made independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.poses import Pose
from calrig.estimation.angles import FloatArray, wrap_deg

BoolArray = npt.NDArray[np.bool_]
Intp = npt.NDArray[np.intp]


SENSES = {"x": 1, "+x": 1, "-x": -1}
"""Of the unit's elevation against the dial's angle, by the axis that lies along the stage's."""


@dataclass(frozen=True, slots=True)
class MountedPoses:
    """Poses of one unit, taken without it being touched.

    Attributes:
        unit: serial number.
        mount: a label.
        nominal_deg: the angle at which it was clamped, as somebody said; None where nobody did. Reversed, the
            unit's elevation is the dial's angle and this one, both with the other sign.
        source: the file or run they are of.
        axis: which of the unit's axes lies along the stage's.
    """

    unit: str
    mount: str
    nominal_deg: float | None
    source: str
    poses: Sequence[Pose]
    axis: str = "x"

    @property
    def sense(self) -> int:
        """+1, or −1 where the elevation falls as the dial's angle rises."""
        return SENSES[self.axis]


@dataclass(frozen=True, slots=True)
class Mount:
    """One clamping: its label, its unit by index, and the angle that was stated, degrees.

    `sense` is −1 of a unit that was reversed (`mount_axis` −x): its elevation falls as the dial rises.
    """

    name: str
    unit: int
    nominal_deg: float | None
    sense: int = 1

    @property
    def axis(self) -> str:
        """Which of the unit's axes lies along the stage's."""
        return "x" if self.sense > 0 else "-x"

    def on_its_turn(self, angle_deg: float) -> float:
        """An angle that was found, within half a turn of the one stated: 241° where that was 240°."""
        nominal_deg = self.nominal_deg or 0.0
        return nominal_deg + float(wrap_deg(angle_deg - nominal_deg))


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """n poses in columns.

    Attributes:
        units: serial numbers.
        mounts: each clamping.
        sources: files or runs; `source` (n,) has the index of each pose's.
        mount: (n,) index of each pose's mount, rising.
        dial_deg: (n,) the stage's own angle.
        approach: (n,) +1 or −1; 0 where it is not known.
        warmer_c: (n,) die temperature less its unit's reference; 0 where it is not known.
        reference_c: (units,) that reference, NaN where the unit's temperature is not known or never changed.
        vector_g: (n, 2) a_y and a_z; NaN where the pose has the reading alone.
        reading: (n,) the elevation read, rad.
        in_order: whether the poses of each source and mount come in the order measured.
        unit: (n,) index of each pose's unit.
        sense: (n,) +1, or −1 of poses whose elevation falls as the dial's angle rises.
        has_vector: (n,) whether a pose has the accelerometer's means.
    """

    units: tuple[str, ...]
    mounts: tuple[Mount, ...]
    sources: tuple[str, ...]
    source: Intp
    mount: Intp
    dial_deg: FloatArray
    approach: FloatArray
    warmer_c: FloatArray
    reference_c: FloatArray
    vector_g: FloatArray
    reading: FloatArray
    in_order: bool = False
    unit: Intp = field(init=False, repr=False)
    sense: FloatArray = field(init=False, repr=False)
    has_vector: BoolArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        units = np.array([mount.unit for mount in self.mounts], dtype=np.intp)
        senses = np.array([mount.sense for mount in self.mounts], dtype=np.float64)
        object.__setattr__(self, "unit", units[self.mount])
        object.__setattr__(self, "sense", senses[self.mount])
        object.__setattr__(self, "has_vector", np.isfinite(self.vector_g).all(axis=1))

    def __len__(self) -> int:
        return len(self.dial_deg)

    def angle(self) -> FloatArray:
        """(n,) the accelerometer's angle, else the reading, rad."""
        seen = np.arctan2(self.vector_g[:, 0], self.vector_g[:, 1])
        return np.where(self.has_vector, seen, self.reading)

    def rows(self, chosen: Intp | BoolArray) -> Table:
        """The same mounts with some of the poses."""
        names = ("source", "mount", "dial_deg", "approach", "warmer_c", "vector_g", "reading")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """Of an arrow of p parameters; 0 of those in no block and not in the border.

    Attributes:
        size: p.
        blocks: places (k,) of each block; `inside` (k, k) the inverse of each by itself, `across` (k, q) that
            times what stands beside it in the border.
        border: places (q,), and `middle` (q, q) the inverse there.
        log_determinant: of the whole.
    """

    size: int
    blocks: tuple[Intp, ...]
    inside: tuple[FloatArray, ...]
    across: tuple[FloatArray, ...]
    border: Intp
    middle: FloatArray
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

    def times_trace(self, matrix: FloatArray) -> float:
        """The trace of the inverse times another arrow (p, p)."""
        found = float((self.middle * matrix[np.ix_(self.border, self.border)]).sum())
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            beside = across @ self.middle
            found += float(((inside + beside @ across.T) * matrix[np.ix_(at, at)]).sum())
            found -= 2.0 * float((beside * matrix[np.ix_(at, self.border)]).sum())
        return found

    def between(self, rows: FloatArray) -> FloatArray:
        """(m, m) the inverse between rows (m, p), which may be of few blocks."""
        beside, found = rows[:, self.border].copy(), np.zeros((len(rows), len(rows)))
        for at, inside, across in zip(self.blocks, self.inside, self.across, strict=True):
            own = rows[:, at]
            if own.any():
                beside -= own @ across
                found += own @ inside @ own.T
        return np.asarray(found + beside @ self.middle @ beside.T)

    def whole(self) -> FloatArray:
        """(p, p)."""
        wide = np.zeros((self.size, len(self.border)))
        wide[self.border] = -np.eye(len(self.border))
        for at, across in zip(self.blocks, self.across, strict=True):
            wide[at] = across
        found = np.asarray(wide @ self.middle @ wide.T)
        for at, inside in zip(self.blocks, self.inside, strict=True):
            found[np.ix_(at, at)] += inside
        return found


def inverse_of(matrix: FloatArray, blocks: Sequence[Intp], border: Intp) -> Inverse:
    """The inverse of a positive definite arrow; scaled, so that units of measure do not matter.

    Args:
        matrix: (p, p), 0 between any two blocks.
        blocks: places of each.
        border: places that all of them touch.
    """
    middle = matrix[np.ix_(border, border)]
    edge = np.diag(middle).copy()
    inside, across, logarithm = [], [], 0.0
    for at in blocks:
        own, more = _inverted(matrix[np.ix_(at, at)])
        beside = matrix[np.ix_(at, border)]
        part = own @ beside
        middle -= beside.T @ part
        inside.append(own)
        across.append(part)
        logarithm += more
    middle, more = _inverted(middle, edge)
    return Inverse(len(matrix), tuple(blocks), tuple(inside), tuple(across), border, middle, logarithm + more)


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
