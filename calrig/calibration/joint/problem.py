"""The joint model as one vector of parameters, and its normal equations, gathered mount by mount.

Parameters in their order: 11 of each unit, an angle of each mount, a cosine and a sine of each order of the
map, and the play; radians and g. A pose touches its own unit, its own mount and the map alone, so that many
units cost no more than their poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.stage_map import LARGEST_BACKLASH_RAD, LARGEST_RAD, basis
from calrig.calibration.joint.table import BoolArray, Intp, Table
from calrig.calibration.joint.unit_model import CURVATURES, LARGEST, NAMES, PER_C, felt
from calrig.calibration.joint.whitening import whitened
from calrig.estimation.angles import FloatArray

WIDTH = len(NAMES)


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Weighted normal equations about some parameters.

    Attributes:
        residuals: (n, 2) measured less expected, g (a reading: rad, and 0).
        matrix: (p, p) JᵀWJ; `gradient` (p,) JᵀWr; `squares` rᵀWr. W whitens correlated poses.
        log_variance: log of the determinant of the noise's correlation.
        blocks: of each mount its poses, its parameters and its derivatives (poses, 2, parameters).
    """

    residuals: FloatArray
    matrix: FloatArray
    gradient: FloatArray
    squares: float
    log_variance: float
    blocks: tuple[tuple[Intp, Intp, FloatArray], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Which parameters the joint model of some poses has, and what it expects of them.

    Attributes:
        orders: of the map; whole numbers, or 360° over a gear's period.
        linear: whether somebody states that the units are.
        correlation: of the noise from one pose of a mount to the next.
    """

    table: Table
    orders: tuple[float, ...]
    linear: bool = False
    correlation: float = 0.0

    @property
    def first_mount(self) -> int:
        """Place of the first mount's angle."""
        return WIDTH * len(self.table.units)

    @property
    def first_order(self) -> int:
        """Place of the first order's cosine."""
        return self.first_mount + len(self.table.mounts)

    @property
    def size(self) -> int:
        """How many parameters there are, free or not."""
        return self.first_order + 2 * len(self.orders) + 1

    @property
    def map_at(self) -> slice:
        """Places of the map, play and all."""
        return slice(self.first_order, self.size)

    def unit_at(self, unit: int) -> slice:
        """Places of one unit."""
        return slice(WIDTH * unit, WIDTH * (unit + 1))

    def order_at(self, place: int) -> Intp:
        """Places of the cosine and sine of one of the orders."""
        return self.first_order + 2 * place + np.arange(2)

    def free(self) -> BoolArray:
        """(p,) which parameters are to be found; the others are 0."""
        free = np.ones(self.size, dtype=np.bool_)
        for unit in range(len(self.table.units)):
            at = WIDTH * unit
            free[at] = bool(self.table.has_vector[self.table.unit == unit].any())
            free[at + np.array(CURVATURES)] = not self.linear
            free[at + np.array(PER_C)] = bool(np.isfinite(self.table.reference_c[unit]))
        free[-1] = len(np.unique(self.table.approach[self.table.approach != 0.0])) > 1
        return free

    def widths(self) -> FloatArray:
        """(p,) how large each may be: what is known of it before the data, as a standard deviation."""
        of_map = np.full(2 * len(self.orders), LARGEST_RAD)
        of_mounts = np.full(len(self.table.mounts), np.pi)
        return np.concatenate(
            [np.tile(LARGEST, len(self.table.units)), of_mounts, of_map, [LARGEST_BACKLASH_RAD]]
        )

    def start(self) -> FloatArray:
        """(p,) where to begin: faultless units, mounts as the mean of their readings says."""
        start = np.zeros(self.size)
        turned = np.exp(1j * (self.table.angle() - np.radians(self.table.dial_deg)))
        for mount in range(len(self.table.mounts)):
            start[self.first_mount + mount] = np.angle(turned[self.table.mount == mount].sum())
        size = np.hypot(self.table.vector_g[:, 0], self.table.vector_g[:, 1])
        for unit in range(len(self.table.units)):
            own = size[(self.table.unit == unit) & self.table.has_vector]
            start[WIDTH * unit] = np.median(own) - 1.0 if len(own) else 0.0
        return start

    def basis(self) -> FloatArray:
        """(n, 2m + 1) columns of the map."""
        return basis(self.table.dial_deg, self.table.approach, self.orders)

    def elevations(self, parameters: FloatArray) -> FloatArray:
        """(n,) of the unit at each pose, rad."""
        mounts = parameters[self.first_mount : self.first_order]
        on_map = self.basis() @ parameters[self.map_at]
        return np.asarray(np.radians(self.table.dial_deg) + on_map + mounts[self.table.mount])

    def normal(self, parameters: FloatArray, weights: FloatArray) -> Normal:
        """The normal equations about some parameters.

        Args:
            parameters: (p,).
            weights: (n,) of the poses; 0 of one that is left out.
        """
        columns, elevation = self.basis(), self.elevations(parameters)
        residuals = np.zeros((len(self.table), 2))
        matrix, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        squares = log_variance = 0.0
        blocks = []
        for k, mount in enumerate(self.table.mounts):
            rows = np.flatnonzero(self.table.mount == k)
            own = self.unit_at(mount.unit)
            at = np.r_[own, self.first_mount + k, self.map_at]
            by_turn = np.concatenate([np.ones((len(rows), 1)), columns[rows]], axis=1)
            left, derivatives = self._of_mount(rows, parameters[own], elevation[rows], by_turn)
            residuals[rows] = left
            both = np.concatenate([derivatives, left[:, :, None]], axis=2)
            flat, more = self._white(rows, both, weights[rows])
            log_variance += more
            matrix[np.ix_(at, at)] += flat[:, :-1].T @ flat[:, :-1]
            gradient[at] += flat[:, :-1].T @ flat[:, -1]
            squares += float(flat[:, -1] @ flat[:, -1])
            blocks.append((rows, at, derivatives))
        return Normal(residuals, matrix, gradient, squares, log_variance, tuple(blocks))

    def _white(self, rows: Intp, both: FloatArray, weights: FloatArray) -> tuple[FloatArray, float]:
        """Derivatives and residuals (m, 2, k) of a mount's poses that count, as independent rows (2m', k)."""
        counted = weights > 0.0
        taken = rows[counted]
        white, own = whitened(both[counted], taken, self.table.source[taken], self.correlation)
        flat = np.sqrt(weights[counted])[:, None, None] * white
        return flat.reshape(-1, both.shape[2]), float((own * (1 + self.table.has_vector[taken])).sum())

    def _of_mount(
        self, rows: Intp, own: FloatArray, elevation: FloatArray, by_turn: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals (m, 2) of a mount's poses, and their derivatives (m, 2, 11 + 1 + map)."""
        expected = felt(own, elevation, self.table.warmer_c[rows])
        turned = expected.by_elevation[:, :, None] * by_turn[:, None, :]
        derivatives = np.concatenate([expected.by_parameters, turned], axis=2)
        left = self.table.vector_g[rows] - expected.vector_g
        bare = np.flatnonzero(~self.table.has_vector[rows])
        if len(bare):  # the reading alone: one response, an angle
            error = self.table.reading[rows[bare]] - expected.angle()[bare]
            left[bare] = np.stack([np.angle(np.exp(1j * error)), np.zeros(len(bare))], axis=1)
            by_angle = expected.turned(derivatives)[bare]
            derivatives[bare] = np.stack([by_angle, np.zeros_like(by_angle)], axis=1)
        return left, derivatives
