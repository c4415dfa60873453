"""Stage, mounts and units as one vector of parameters, and its normal equations, gathered mount by mount.

Parameters in their order: those of each unit, two tilts of each mount, the dip of the stage's axis, what each
mount has of its own (`DEVIATIONS`), an angle of each mount, a cosine and a sine of each order of the map, and
the backlash; radians and g. Of whole units all 21 parameters are there. Of units in the plane those that a
rotation about x shows (`IN_PLANE`), and neither tilts nor dip: they are fixed at 0. A pose touches its own
unit, its own mount and the stage alone, so that many units cost no more than their poses.

With each unit's frame its own sensor's, and each mount free to turn, nothing is left that data could not tell
in principle.
"""

from dataclasses import dataclass, field

import numpy as np

from calrig.calibration.separation.accelerometer import (
    BIAS,
    CUBIC,
    GAIN,
    IN_PLANE,
    LARGEST,
    NAMES,
    PER_C,
    QUADRATIC,
    QUARTIC,
    SKEW,
    WIDTH,
    SensedVector,
    sensed_vector,
    turned,
)
from calrig.calibration.separation.clamping import stage_direction, tilted
from calrig.calibration.separation.normal_equations import Arrow, Inverse, Normal, inverse_of, whitened
from calrig.calibration.separation.pose_table import Table
from calrig.calibration.separation.stage_map import LARGEST_BACKLASH_RAD, LARGEST_RAD, basis
from calrig.estimation.angles import BoolArray, FloatArray, Intp

LARGEST_TILT_RAD = np.radians(10.0)
"""A sensor in its case, and the case on its seat."""
LARGEST_DIP_RAD = np.radians(5.0)
TILTS = 2
MOVED_ORDERS = (1.0, 2.0)
"""Orders by which the map of one mount may differ from the map of all."""
OWN = np.array([BIAS.start + 1, BIAS.start + 2, GAIN.start + 1, GAIN.start + 2, SKEW.stop - 1])
"""What a mount has of its own of an accelerometer: offsets, by strain; gains and skew, by a seat askew."""
OWN_OFFSETS = 2
DEVIATIONS = len(OWN) + 2 * len(MOVED_ORDERS)
"""Of a mount: `OWN`, then cosine and sine of each order of its own map."""
_QUADRATIC_TO_CUBIC = slice(QUADRATIC.start, CUBIC.stop)


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of what may differ from the plain model; 0 of what does not enter it.

    Attributes:
        offset_g: of a mount's own offset of an axis about the unit's.
        askew: of a mount's own gains and skew about the unit's, as of a seat that is askew.
        map_rad: of each coefficient of a mount's own map about the map of all.
        quartic_g: of a unit's quartic terms.
    """

    offset_g: float = 0.0
    askew: float = 0.0
    map_rad: float = 0.0
    quartic_g: float = 0.0


PLAIN = Spread()


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Which parameters the joint model of some poses has, and what it expects of them.

    Attributes:
        orders: of the map; whole numbers, or 360° over a gear's period.
        linear: whether the units are stated to be linear.
        correlation: of the noise from one pose of a mount to the next.
        spread: of what differs between mounts, and of quartic terms; only of units in the plane.
        shape: (units, c) noise of each component over that of all, root mean square; None of equal ones.
        columns: (n, 2m + 1) of the map.
        free: (p,) which parameters are to be found; the others are fixed at 0.
        own: of each mount, places (k,) of what its poses touch beside the map; its angle is the last.
        blocks: places of what is free beside the map, in blocks that touch one another by the map alone.
    """

    table: Table
    orders: tuple[float, ...]
    linear: bool = False
    correlation: float = 0.0
    spread: Spread = PLAIN
    shape: FloatArray | None = None
    columns: FloatArray = field(init=False, repr=False)
    free: BoolArray = field(init=False, repr=False)
    own: tuple[Intp, ...] = field(init=False, repr=False)
    blocks: tuple[Intp, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        columns = basis(self.table.dial_deg, self.table.approach, self.orders)
        object.__setattr__(self, "columns", columns)
        own = (
            np.r_[
                self.unit_at(mount.unit),
                self.tilts_at(k),
                self.dip_at,
                self.deviations_at(k),
                self.first_mount + k,
            ]
            for k, mount in enumerate(self.table.mounts)
        )
        object.__setattr__(self, "own", tuple(own))
        object.__setattr__(self, "free", self._free())
        object.__setattr__(self, "blocks", self._blocks())

    # --- Where the parameters are ---

    @property
    def of_unit(self) -> Intp:
        """Which of an accelerometer's 21 parameters a unit has."""
        return np.arange(WIDTH) if self.table.is_whole else IN_PLANE

    def unit_at(self, unit: int) -> slice:
        """Places of one unit."""
        width = len(self.of_unit)
        return slice(width * unit, width * (unit + 1))

    @property
    def dip_at(self) -> slice:
        """Place of the dip of the stage's axis; empty of units in the plane."""
        n_mounts, whole = len(self.table.mounts), self.table.is_whole
        first = len(self.of_unit) * len(self.table.units) + TILTS * n_mounts * whole
        return slice(first, first + whole)

    def tilts_at(self, mount: int) -> slice:
        """Places of one mount's tilts; empty of units in the plane."""
        first = len(self.of_unit) * len(self.table.units) + TILTS * mount * self.table.is_whole
        return slice(first, first + TILTS * self.table.is_whole)

    @property
    def n_deviations(self) -> int:
        """Parameters by which a mount may differ from the others; none of whole units."""
        return 0 if self.table.is_whole else DEVIATIONS

    def deviations_at(self, mount: int) -> slice:
        """Places of one mount's own offsets and of its own map."""
        first = int(self.dip_at.stop) + self.n_deviations * mount
        return slice(first, first + self.n_deviations)

    def first_mount_of(self, unit: int) -> int:
        """Index of the mount whose offsets are the unit's."""
        return next(k for k, mount in enumerate(self.table.mounts) if mount.unit == unit)

    def touched_by(self, unit: int) -> Intp:
        """Places of a unit's parameters, its first mount's own offsets among them."""
        own = self.deviations_at(self.first_mount_of(unit))
        n_own = min(OWN_OFFSETS, self.n_deviations)
        return np.concatenate([np.r_[self.unit_at(unit)], own.start + np.arange(n_own)])

    @property
    def first_mount(self) -> int:
        """Place of the first mount's angle."""
        return int(self.dip_at.stop) + self.n_deviations * len(self.table.mounts)

    @property
    def first_order(self) -> int:
        """Place of the first order's cosine."""
        return self.first_mount + len(self.table.mounts)

    @property
    def size(self) -> int:
        """How many parameters there are, free or not."""
        return self.first_order + 2 * len(self.orders) + 1

    @property
    def mounts_at(self) -> slice:
        """Places of the mounts' angles."""
        return slice(self.first_mount, self.first_order)

    @property
    def map_at(self) -> slice:
        """Places of the map, backlash and all."""
        return slice(self.first_order, self.size)

    @property
    def n_own(self) -> int:
        """How many parameters the poses of a mount touch beside the map."""
        return len(self.own[0])

    def title(self, place: int) -> str:
        """Name a parameter."""
        table, width = self.table, len(self.of_unit)
        if place < width * len(table.units):
            whose = f" of unit {table.units[place // width]}" if len(table.units) > 1 else ""
            return f"{NAMES[self.of_unit[place % width]]}{whose}"
        if place < self.dip_at.start:
            return f"tilt of mount {table.mounts[(place - width * len(table.units)) // TILTS].name}"
        if place < self.dip_at.stop:
            return "level of the stage's axis"
        if place < self.first_order:
            return self._title_of_mount(place)
        if place == self.size - 1:
            return "the play"
        return f"order {self.orders[(place - self.first_order) // 2]:g} of the stage"

    def _title_of_mount(self, place: int) -> str:
        if place >= self.first_mount:
            return f"angle of mount {self.table.mounts[place - self.first_mount].name}"
        mount, which = divmod(place - self.dip_at.stop, self.n_deviations)
        what = "own offset" if which < OWN_OFFSETS else "seat" if which < len(OWN) else "own map"
        return f"{what} of mount {self.table.mounts[mount].name}"

    # --- What is known of them before the data ---

    def _free(self) -> BoolArray:
        table, free = self.table, np.ones(self.size, dtype=np.bool_)
        width, n_units = len(self.of_unit), len(table.units)
        own = np.ones((n_units, WIDTH), dtype=np.bool_)
        # a reading is an angle: the gain that all axes have in common is not in it
        own[:, GAIN.stop - 1] = np.bincount(table.unit, table.has_vector, minlength=n_units) > 0
        own[:, _QUADRATIC_TO_CUBIC] = not self.linear
        own[:, PER_C] = np.isfinite(table.reference_c)[:, None]
        own[:, QUARTIC] = self.spread.quartic_g > 0.0
        free[: width * n_units] = own[:, self.of_unit].ravel()
        free[self.dip_at.stop : self.first_mount] = self._of_deviations() > 0.0
        free[-1] = len(np.unique(table.approach[table.approach != 0.0])) > 1
        return free

    def _blocks(self) -> tuple[Intp, ...]:
        if self.table.is_whole:  # the dip is common to all units
            return (np.flatnonzero(self.free[: self.first_order]),)
        units = np.array([mount.unit for mount in self.table.mounts], dtype=np.intp)
        by_unit = np.split(np.argsort(units, kind="stable"), np.cumsum(np.bincount(units))[:-1])
        places = (
            np.concatenate(
                [
                    np.r_[self.unit_at(unit)],
                    *(np.r_[self.deviations_at(int(mount))] for mount in mounts),
                    self.first_mount + mounts,
                ]
            )
            for unit, mounts in enumerate(by_unit)
        )
        return tuple(at[self.free[at]] for at in places)

    def _of_deviations(self) -> FloatArray:
        """(mounts·k,) how far each may be from 0."""
        counts = OWN_OFFSETS, len(OWN) - OWN_OFFSETS, DEVIATIONS - len(OWN)
        one = np.repeat([self.spread.offset_g, self.spread.askew, self.spread.map_rad], counts)
        return np.tile(one[: self.n_deviations], len(self.table.mounts))

    def widths(self) -> FloatArray:
        """(p,) how large each may be: what is known of it before the data, as a standard deviation."""
        table = self.table
        counts = (
            (LARGEST_TILT_RAD, TILTS * len(table.mounts) * table.is_whole),
            (LARGEST_DIP_RAD, int(table.is_whole)),
            (np.pi, len(table.mounts)),
            (LARGEST_RAD, 2 * len(self.orders)),
            (LARGEST_BACKLASH_RAD, 1),
        )
        largest = LARGEST.copy()
        largest[QUARTIC] = self.spread.quartic_g or LARGEST[QUARTIC]
        parts = [np.tile(largest[self.of_unit], len(table.units))]
        parts += [np.full(count, width) for width, count in counts]
        own = self._of_deviations()
        return np.concatenate([*parts[:3], np.where(own > 0.0, own, 1.0), *parts[3:]])

    def start(self) -> FloatArray:
        """(p,) where to begin: faultless units, squarely clamped, sized and turned as their poses are."""
        start, table = np.zeros(self.size), self.table
        apart, n = table.turn() - np.radians(table.dial_deg), len(table.mounts)
        s, c = (np.bincount(table.mount, of(apart), minlength=n) for of in (np.sin, np.cos))
        start[self.mounts_at] = np.arctan2(s, c)
        gains = np.flatnonzero(np.isin(self.of_unit, np.arange(WIDTH)[GAIN]))
        size_g = table.size_g
        for unit in range(len(table.units)):
            own = size_g[(table.unit == unit) & table.has_vector]
            start[self.unit_at(unit)][gains] = np.median(own) - 1.0 if len(own) else 0.0
        return start

    # --- What is expected of the poses ---

    def accelerometers(self, parameters: FloatArray) -> FloatArray:
        """(units, 21) of each unit, 0 of what is fixed."""
        found = np.zeros((len(self.table.units), WIDTH))
        found[:, self.of_unit] = parameters[: found.shape[0] * len(self.of_unit)].reshape(len(found), -1)
        return found

    def accelerometer(self, parameters: FloatArray, unit: int) -> FloatArray:
        """(21,) of one unit, its offsets those of its first mount."""
        found = np.zeros(WIDTH)
        found[self.of_unit] = parameters[self.unit_at(unit)]
        own = parameters[self.deviations_at(self.first_mount_of(unit))][:OWN_OFFSETS]
        found[BIAS][3 - len(own) :] += own
        return found

    def turns(self, parameters: FloatArray) -> FloatArray:
        """(n,) the table's turn at each pose, from where gravity is the mount's third axis, rad."""
        on_map = self.columns @ parameters[self.map_at]
        if self.spread.map_rad > 0.0:
            own = self._deviations(parameters)[self.table.mount, len(OWN) :]
            on_map = on_map + np.einsum("nk,nk->n", self._moved(), own)
        return np.asarray(
            np.radians(self.table.dial_deg) + on_map + parameters[self.mounts_at][self.table.mount]
        )

    def _deviations(self, parameters: FloatArray) -> FloatArray:
        """(mounts, k) of each."""
        own = parameters[self.dip_at.stop : self.first_mount]
        return own.reshape(len(self.table.mounts), self.n_deviations)

    def _moved(self) -> FloatArray:
        """(n, k) columns of a mount's own map."""
        return basis(self.table.dial_deg, np.zeros(len(self.table)), MOVED_ORDERS)[:, :-1]

    def _own(self, parameters: FloatArray) -> FloatArray:
        """(n, 21) of each pose's unit as it is in its mount."""
        found = self.accelerometers(parameters)[self.table.unit]
        if self.n_deviations:
            found[:, OWN] += self._deviations(parameters)[self.table.mount, : len(OWN)]
        return found

    def clamped(self, parameters: FloatArray, mount: int) -> FloatArray:
        """(3, 3) from the table's frame to the sensor's; its first column is the stage's axis."""
        face = self.table.faces[mount]
        if not self.table.is_whole:
            return np.asarray(face)
        return np.asarray(face @ tilted(parameters[self.tilts_at(mount)])[0])

    def directions(self, parameters: FloatArray) -> FloatArray:
        """(n, 3) upward in each unit's own frame."""
        return _turned_by(self._frames(parameters), self._stage(parameters)[0])

    def expected(self, parameters: FloatArray) -> SensedVector:
        """The vector of each pose."""
        own = self._own(parameters)
        return sensed_vector(own, self.directions(parameters), self.table.warmer_c)

    def normal(self, parameters: FloatArray, weights: FloatArray) -> Normal:
        """Return the normal equations about parameters (p,), with weights (n,): 0 of a pose left out."""
        left, derivatives = self._responses(parameters)
        kept, own = np.flatnonzero(weights > 0.0), self.n_own
        white, log_variance = self._white(left, derivatives, weights, kept)
        gradient, of_map = np.zeros(self.size), white[:, own:].T @ white[:, own:]
        gradient[self.map_at] = of_map[:-1, -1]
        inside = tuple(np.zeros((len(at), len(at))) for at in self.blocks)
        across = tuple(np.zeros((len(at), len(of_map) - 1)) for at in self.blocks)
        ends = left.shape[1] * np.searchsorted(self.table.mount[kept], np.arange(len(self.table.mounts) + 1))
        for k, mount in enumerate(self.table.mounts):
            rows, at = white[ends[k] : ends[k + 1]], self.own[k]
            products = rows[:, :own].T @ rows
            gradient[at] += products[:, -1]
            block, free = 0 if self.table.is_whole else mount.unit, np.flatnonzero(self.free[at])
            places = np.searchsorted(self.blocks[block], at[free])
            inside[block][np.ix_(places, places)] += products[np.ix_(free, free)]
            across[block][places] += products[free, own:-1]
        border = np.arange(self.first_order, self.size)
        matrix = Arrow(self.size, self.blocks, inside, across, border, of_map[:-1, :-1])
        return Normal(left, matrix, gradient, float(of_map[-1, -1]), log_variance, derivatives)

    def inverse(self, matrix: Arrow) -> Inverse:
        """Of normal equations, 0 of parameters that are not free."""
        return inverse_of(matrix, self.free[self.first_order :])

    def _stage(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The vertical at each pose as the table has it, and its derivatives by the turn and by the dip."""
        return stage_direction(self.turns(parameters), float(parameters[self.dip_at].sum()))

    def _frames(self, parameters: FloatArray) -> FloatArray:
        """(n, 3, 3) `clamped` of each pose."""
        if not self.table.is_whole:
            return self.table.faces[self.table.mount]
        mounts = range(len(self.table.mounts))
        return np.stack([self.clamped(parameters, mount) for mount in mounts])[self.table.mount]

    def _responses(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, c), and derivatives (n, c, k) by unit, tilts, dip, mount and map of each pose."""
        table, at = self.table, self.table.components
        (up, by_turn, by_dip), frames = self._stage(parameters), self._frames(parameters)
        own = self._own(parameters)
        sensed = sensed_vector(own, _turned_by(frames, up), table.warmer_c)
        by_direction = sensed.by_direction[:, at]

        def through(change: FloatArray) -> FloatArray:
            """(n, c, 1) what a change (n, 3) of the direction does to the vector."""
            return _turned_by(by_direction, change)[:, :, None]

        parts = [sensed.by_parameters[:, at, self.of_unit]]
        if table.is_whole:
            by_tilts = np.stack(
                [face @ tilted(parameters[self.tilts_at(mount)])[1] for mount, face in enumerate(table.faces)]
            )[table.mount]
            parts += [through(_turned_by(by_tilts[:, k], up)) for k in range(TILTS)]
            parts.append(through(_turned_by(frames, by_dip)))
        by_angle = through(_turned_by(frames, by_turn))
        if self.n_deviations:
            parts.append(sensed.by_parameters[:, at][:, :, OWN])
            parts.append(by_angle * self._moved()[:, None, :])
        derivatives = np.concatenate([*parts, by_angle, by_angle * self.columns[:, None, :]], axis=2)
        left = table.vector_g[:, at] - sensed.vector_g[:, at]
        bare = np.flatnonzero(~table.has_vector)
        if len(bare):  # the reading alone, of a unit in the plane: one response, an angle
            error = table.reading[bare] - table.turn_of(sensed.vector_g)[bare]
            left[bare] = np.stack([np.angle(np.exp(1j * error)), np.zeros(len(bare))], axis=1)
            turn = turned(sensed.vector_g[bare, at], derivatives[bare]) * table.sense[bare, None]
            derivatives[bare] = np.stack([turn, np.zeros_like(turn)], axis=1)
        if self.shape is not None:
            shape = self.shape[table.unit]
            left, derivatives = left / shape, derivatives / shape[:, :, None]
        return left, derivatives

    def _white(
        self, left: FloatArray, derivatives: FloatArray, weights: FloatArray, kept: Intp
    ) -> tuple[FloatArray, float]:
        """Derivatives and, last, residuals of the poses that count as independent rows (c·m, k + 1)."""
        both = np.concatenate([derivatives, left[:, :, None]], axis=2)
        taken = both if len(kept) == len(both) else both[kept]
        chain = self.table.mount[kept] * len(self.table.sources) + self.table.source[kept]
        white, own = whitened(taken, kept, chain, self.correlation)
        if (weights[kept] != 1.0).any():
            white = np.sqrt(weights[kept])[:, None, None] * white
        return white.reshape(-1, both.shape[2]), float((own * self.table.responses[kept]).sum())


def _turned_by(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """(n, c) each matrix (n, c, 3) times its vector (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
