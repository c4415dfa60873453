"""Units clamped by several faces, their mounts and one stage as one vector of parameters.

Parameters in their order: 18 of each unit, two tilts of each mount, the dip of the stage's axis, an angle of
each mount, a cosine and a sine of each order of the map, and the play; radians and g. With each unit's frame
its own sensor's, and each mount free to turn, nothing is left that data could not tell in principle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calrig.calibration.separation.pose_table import BoolArray, Intp, Table, whitened
from calrig.calibration.separation.stage_map import Parameters, basis
from calrig.calibration.separation.three_axis_model import (
    CUBIC,
    LARGEST,
    NAMES,
    PER_C,
    QUADRATIC,
    WIDTH,
    sensed_vector,
)
from calrig.calibration.separation.three_axis_table import (
    ThreeAxisTable,
    face_matrix,
    stage_direction,
    tilted,
)
from calrig.estimation.angles import FloatArray

LARGEST_TILT_RAD = np.radians(10.0)
"""A sensor in its case, and the case on its seat."""
LARGEST_DIP_RAD = np.radians(5.0)
TILTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Weighted normal equations about some parameters.

    Attributes:
        residuals: (n, 3) measured less expected over the shape of the noise, g.
        matrix: (p, p) JᵀWJ; `gradient` (p,) JᵀWr; `squares` rᵀWr. W whitens correlated poses.
        log_variance: log of the determinant of the noise's correlation.
        blocks: of each mount its poses, its parameters and its derivatives (poses, 3, parameters).
    """

    residuals: FloatArray
    matrix: FloatArray
    gradient: FloatArray
    squares: float
    log_variance: float
    blocks: tuple[tuple[Intp, Intp, FloatArray], ...]


@dataclass(frozen=True, slots=True, eq=False)
class ThreeAxisProblem(Parameters):
    """Which parameters such poses have, and what is expected of them.

    Attributes:
        of: the poses.
        orders: of the map.
        linear: whether somebody states that the units are.
        shape: (units, 3) noise of each axis over that of all, root mean square.
        correlation: of the noise from one pose of a mount to the next.
        table: the poses as of mounts about x.
    """

    WIDTH: ClassVar[int] = WIDTH
    of: ThreeAxisTable
    orders: tuple[float, ...]
    linear: bool
    shape: FloatArray
    correlation: float = 0.0
    table: Table = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", self.of.seen)

    @property
    def dip_at(self) -> int:
        """Place of the stage's dip."""
        return WIDTH * len(self.table.units) + TILTS * len(self.table.mounts)

    @property
    def first_mount(self) -> int:
        """Place of the first mount's angle."""
        return self.dip_at + 1

    def tilts_at(self, mount: int) -> slice:
        """Places of one mount's tilts."""
        first = WIDTH * len(self.table.units) + TILTS * mount
        return slice(first, first + TILTS)

    @property
    def free(self) -> BoolArray:
        """(p,) which parameters are to be found; the others are 0."""
        free = np.ones(self.size, dtype=np.bool_)
        for unit in range(len(self.table.units)):
            own = free[self.unit_at(unit)]
            own[QUADRATIC] = own[CUBIC] = not self.linear
            own[PER_C] = bool(np.isfinite(self.table.reference_c[unit]))
        free[-1] = self.tells_play()
        return free

    @property
    def blocks(self) -> tuple[Intp, ...]:
        """Places of what is free beside the map, all together: the stage's dip is common to all units."""
        return (np.flatnonzero(self.free[: self.first_order]),)

    def widths(self) -> FloatArray:
        """(p,) how large each may be: what is known of it before the data, as a standard deviation."""
        n_units, n_mounts = len(self.table.units), len(self.table.mounts)
        return np.concatenate(
            [
                np.tile(LARGEST, n_units),
                np.full(TILTS * n_mounts, LARGEST_TILT_RAD),
                [LARGEST_DIP_RAD],
                self.widths_of_stage(),
            ]
        )

    def start(self) -> FloatArray:
        """(p,) where to begin: faultless units squarely clamped, mounts as the mean of their angles says."""
        start = np.zeros(self.size)
        turned = np.exp(1j * (self.table.angle() - np.radians(self.table.dial_deg)))
        for mount in range(len(self.table.mounts)):
            start[self.first_mount + mount] = np.angle(turned[self.table.mount == mount].sum())
        return start

    def basis(self) -> FloatArray:
        """(n, 2m + 1) columns of the map."""
        return basis(self.table.dial_deg, self.table.approach, self.orders)

    def turns(self, parameters: FloatArray) -> FloatArray:
        """(n,) the table's turn at each pose, from where gravity is the mount's third axis, rad."""
        mounts = parameters[self.mounts_at]
        on_map = self.basis() @ parameters[self.map_at]
        return np.asarray(np.radians(self.table.dial_deg) + on_map + mounts[self.table.mount])

    def normal(self, parameters: FloatArray, weights: FloatArray) -> Normal:
        """The normal equations about some parameters, of residuals over the shape of the noise.

        Args:
            parameters: (p,).
            weights: (n,) of the poses; 0 of one that is left out.
        """
        columns, turns = self.basis(), self.turns(parameters)
        residuals = np.zeros((len(self.table), 3))
        matrix, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        squares = log_variance = 0.0
        blocks = []
        for k, mount in enumerate(self.table.mounts):
            rows = np.flatnonzero(self.table.mount == k)
            at = np.r_[
                self.unit_at(mount.unit), self.tilts_at(k), self.dip_at, self.first_mount + k, self.map_at
            ]
            expected, derivatives = self._of_mount(k, parameters, turns[rows], columns[rows])
            shape = self.shape[mount.unit]
            residuals[rows] = (self.of.vector_g[rows] - expected) / shape
            derivatives /= shape[:, None]
            both = np.concatenate([derivatives, residuals[rows][:, :, None]], axis=2)
            flat, more = self._white(rows, both, weights[rows])
            log_variance += more
            matrix[np.ix_(at, at)] += flat[:, :-1].T @ flat[:, :-1]
            gradient[at] += flat[:, :-1].T @ flat[:, -1]
            squares += float(flat[:, -1] @ flat[:, -1])
            blocks.append((rows, at, derivatives))
        return Normal(residuals, matrix, gradient, squares, log_variance, tuple(blocks))

    def expected_g(self, parameters: FloatArray) -> FloatArray:
        """(n, 3) the vectors."""
        columns, turns = self.basis(), self.turns(parameters)
        expected = np.zeros_like(self.of.vector_g)
        for k in range(len(self.table.mounts)):
            rows = np.flatnonzero(self.table.mount == k)
            expected[rows] = self._of_mount(k, parameters, turns[rows], columns[rows])[0]
        return expected

    def clamped(self, parameters: FloatArray, mount: int) -> FloatArray:
        """(3, 3) from the table's frame to the sensor's; its first column is the stage's axis."""
        return np.asarray(face_matrix(self.of.faces[mount]) @ tilted(parameters[self.tilts_at(mount)])[0])

    def directions(self, parameters: FloatArray) -> FloatArray:
        """(n, 3) upward in each unit's own frame."""
        turns, found = self.turns(parameters), np.zeros((len(self.table), 3))
        for k in range(len(self.table.mounts)):
            rows = np.flatnonzero(self.table.mount == k)
            up = stage_direction(turns[rows], float(parameters[self.dip_at]))[0]
            found[rows] = up @ self.clamped(parameters, k).T
        return found

    def title(self, place: int) -> str:
        """What a parameter is."""
        table = self.table
        if place < WIDTH * len(table.units):
            whose = f" of unit {table.units[place // WIDTH]}" if len(table.units) > 1 else ""
            return NAMES[place % WIDTH] + whose
        if place < self.dip_at:
            return f"tilt of mount {table.mounts[(place - WIDTH * len(table.units)) // TILTS].name}"
        if place == self.dip_at:
            return "level of the stage's axis"
        if place < self.first_order:
            return f"angle of mount {table.mounts[place - self.first_mount].name}"
        return self.title_on_map(place)

    def _of_mount(
        self, mount: int, parameters: FloatArray, turns: FloatArray, columns: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Vectors (m, 3) of a mount's poses, and their derivatives (m, 3, 18 + 2 + 1 + 1 + map)."""
        unit, face = self.table.mounts[mount].unit, face_matrix(self.of.faces[mount])
        tilt, by_tilts = tilted(parameters[self.tilts_at(mount)])
        up, by_turn, by_dip = stage_direction(turns, float(parameters[self.dip_at]))
        rows = self.table.mount == mount
        sensed = sensed_vector(
            parameters[self.unit_at(unit)], up @ (face @ tilt).T, self.table.warmer_c[rows]
        )

        def through(change: FloatArray) -> FloatArray:
            """(m, 3) what a change (m, 3) of the direction does to the vector."""
            return np.asarray(np.einsum("nij,nj->ni", sensed.by_direction, change))

        turned = through(by_turn @ (face @ tilt).T)[:, :, None]
        directions = [
            *(through(up @ (face @ by_tilt).T)[:, :, None] for by_tilt in by_tilts),
            through(by_dip @ (face @ tilt).T)[:, :, None],
            turned,
            turned * columns[:, None, :],
        ]
        return sensed.vector_g, np.concatenate([sensed.by_parameters, *directions], axis=2)

    def _white(self, rows: Intp, both: FloatArray, weights: FloatArray) -> tuple[FloatArray, float]:
        """Derivatives and residuals (m, 3, k) of a mount's poses that count, as independent rows (3m', k)."""
        counted = weights > 0.0
        taken = rows[counted]
        white, own = whitened(both[counted], taken, self.table.source[taken], self.correlation)
        flat = np.sqrt(weights[counted])[:, None, None] * white
        return flat.reshape(-1, both.shape[2]), float(3.0 * own.sum())
