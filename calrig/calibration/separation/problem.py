"""The joint model as one vector of parameters, and its normal equations, gathered mount by mount.

Parameters in their order: 11 of each unit, an angle of each mount, a cosine and a sine of each order of the
map, and the play; radians and g. A pose touches its own unit, its own mount and the map alone, so that many
units cost no more than their poses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calrig.calibration.separation.pose_table import BoolArray, Intp, Inverse, Table, inverse_of, whitened
from calrig.calibration.separation.stage_map import Parameters, basis
from calrig.calibration.separation.unit_model import CURVATURES, LARGEST, NAMES, PER_C, Sensed, sensed
from calrig.estimation.angles import FloatArray

WIDTH = len(NAMES)
OWN = WIDTH + 1
"""Parameters of a pose's unit and mount."""


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Weighted normal equations about some parameters.

    Attributes:
        residuals: (n, 2) measured less expected, g (a reading: rad, and 0).
        matrix: (p, p) JᵀWJ; `gradient` (p,) JᵀWr; `squares` rᵀWr. W whitens correlated poses.
        log_variance: log of the determinant of the noise's correlation.
        derivatives: (n, 2, 12 + map) of each pose by its unit, its mount (`Problem.own_at`) and the map.
    """

    residuals: FloatArray
    matrix: FloatArray
    gradient: FloatArray
    squares: float
    log_variance: float
    derivatives: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Problem(Parameters):
    """Which parameters the joint model of some poses has, and what it expects of them.

    Attributes:
        orders: of the map; whole numbers, or 360° over a gear's period.
        linear: whether somebody states that the units are.
        correlation: of the noise from one pose of a mount to the next.
        columns: (n, 2m + 1) of the map.
        free: (p,) which parameters are to be found; the others are 0.
        blocks: of each unit the places of what is free of its own and of its mounts.
    """

    WIDTH: ClassVar[int] = WIDTH
    table: Table
    orders: tuple[float, ...]
    linear: bool = False
    correlation: float = 0.0
    columns: FloatArray = field(init=False, repr=False)
    free: BoolArray = field(init=False, repr=False)
    blocks: tuple[Intp, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        columns = basis(self.table.dial_deg, self.table.approach, self.orders)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "free", self._free())
        object.__setattr__(self, "blocks", self._blocks())

    @property
    def first_mount(self) -> int:
        """Place of the first mount's angle."""
        return WIDTH * len(self.table.units)

    def own_at(self, mount: int) -> Intp:
        """(12,) places of a mount's unit and its angle."""
        own = self.unit_at(self.table.mounts[mount].unit)
        return np.append(np.arange(own.start, own.stop), self.first_mount + mount)

    @property
    def border(self) -> Intp:
        """Places of what is free of the map."""
        return self.first_order + np.flatnonzero(self.free[self.first_order :])

    def _free(self) -> BoolArray:
        table, free = self.table, np.ones(self.size, dtype=np.bool_)
        with_vector = np.bincount(table.unit, table.has_vector, minlength=len(table.units)) > 0
        own = free[: self.first_mount].reshape(-1, WIDTH)
        own[:, 0] = with_vector
        own[:, CURVATURES] = not self.linear
        own[:, PER_C] = np.isfinite(table.reference_c)[:, None]
        free[-1] = self.tells_play()
        return free

    def _blocks(self) -> tuple[Intp, ...]:
        units = np.array([mount.unit for mount in self.table.mounts], dtype=np.intp)
        by_unit = np.split(np.argsort(units, kind="stable"), np.cumsum(np.bincount(units))[:-1])
        places = (
            np.concatenate([np.arange(WIDTH * unit, WIDTH * (unit + 1)), self.first_mount + mounts])
            for unit, mounts in enumerate(by_unit)
        )
        return tuple(at[self.free[at]] for at in places)

    def inverse(self, matrix: FloatArray) -> Inverse:
        """Of normal equations (p, p), 0 of parameters that are not free."""
        return inverse_of(matrix, self.blocks, self.border)

    def widths(self) -> FloatArray:
        """(p,) how large each may be: what is known of it before the data, as a standard deviation."""
        return np.concatenate([np.tile(LARGEST, len(self.table.units)), self.widths_of_stage()])

    def start(self) -> FloatArray:
        """(p,) where to begin: faultless units, mounts as the mean of their readings says."""
        start = np.zeros(self.size)
        table = self.table
        apart, n = table.angle() - table.sense * np.radians(table.dial_deg), len(table.mounts)
        s, c = (np.bincount(table.mount, of(apart), minlength=n) for of in (np.sin, np.cos))
        start[self.mounts_at] = np.arctan2(s, c)
        size = np.hypot(self.table.vector_g[:, 0], self.table.vector_g[:, 1])
        for unit in range(len(self.table.units)):
            own = size[(self.table.unit == unit) & self.table.has_vector]
            start[WIDTH * unit] = np.median(own) - 1.0 if len(own) else 0.0
        return start

    def elevations(self, parameters: FloatArray) -> FloatArray:
        """(n,) of the unit at each pose, rad."""
        mounts = parameters[self.mounts_at]
        on_map = self.columns @ parameters[self.map_at]
        table_at = np.radians(self.table.dial_deg) + on_map
        return np.asarray(self.table.sense * table_at + mounts[self.table.mount])

    def expected(self, parameters: FloatArray) -> Sensed:
        """The vector of each pose."""
        own = parameters[: self.first_mount].reshape(-1, WIDTH)[self.table.unit].T
        return sensed(own, self.elevations(parameters), self.table.warmer_c)

    def normal(self, parameters: FloatArray, weights: FloatArray) -> Normal:
        """The normal equations about some parameters.

        Args:
            parameters: (p,).
            weights: (n,) of the poses; 0 of one that is left out.
        """
        left, derivatives = self._responses(parameters)
        kept = np.flatnonzero(weights > 0.0)
        white, log_variance = self._white(left, derivatives, weights, kept)
        matrix, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        of_map = white[:, OWN:].T @ white[:, OWN:]
        matrix[self.map_at, self.map_at] = of_map[:-1, :-1]
        gradient[self.map_at] = of_map[:-1, -1]
        ends = 2 * np.searchsorted(self.table.mount[kept], np.arange(len(self.table.mounts) + 1))
        for k in range(len(self.table.mounts)):
            rows, at = white[ends[k] : ends[k + 1]], self.own_at(k)
            products = rows[:, :OWN].T @ rows
            matrix[np.ix_(at, at)] += products[:, :OWN]
            matrix[at, self.map_at] += products[:, OWN:-1]
            gradient[at] += products[:, -1]
        matrix[self.map_at, : self.first_order] = matrix[: self.first_order, self.map_at].T
        return Normal(left, matrix, gradient, float(of_map[-1, -1]), log_variance, derivatives)

    def _white(
        self, left: FloatArray, derivatives: FloatArray, weights: FloatArray, kept: Intp
    ) -> tuple[FloatArray, float]:
        """Derivatives and, last, residuals of the poses that count as independent rows (2m, 12 + map + 1)."""
        both = np.concatenate([derivatives, left[:, :, None]], axis=2)
        taken = both if len(kept) == len(both) else both[kept]
        chain = self.table.mount[kept] * len(self.table.sources) + self.table.source[kept]
        white, own = whitened(taken, kept, chain, self.correlation)
        if (weights[kept] != 1.0).any():
            white = np.sqrt(weights[kept])[:, None, None] * white
        return white.reshape(-1, both.shape[2]), float((own * (1 + self.table.has_vector[kept])).sum())

    def _responses(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, 2), and derivatives (n, 2, 11 + 1 + map) by unit, mount and map of each pose."""
        table = self.table
        expected = self.expected(parameters)
        turned = expected.by_elevation[:, :, None] * (table.sense[:, None] * self.columns)[:, None, :]
        derivatives = np.concatenate(
            [expected.by_parameters, expected.by_elevation[:, :, None], turned], axis=2
        )
        left = table.vector_g - expected.vector_g
        bare = np.flatnonzero(~table.has_vector)
        if len(bare):  # the reading alone: one response, an angle
            error = table.reading[bare] - expected.angle()[bare]
            left[bare] = np.stack([np.angle(np.exp(1j * error)), np.zeros(len(bare))], axis=1)
            by_angle = expected.turned(derivatives)[bare]
            derivatives[bare] = np.stack([by_angle, np.zeros_like(by_angle)], axis=1)
        return left, derivatives
