"""The stage's error of angle: a harmonic series of the dial angle, and the play.

    map(ψ, approach) = Σ (a_k·cos kψ + b_k·sin kψ) + backlash/2·approach

There is no k = 0: a constant is the mounts'. An order need be no whole number: a worm of period P has 360/P.

Where the parameters of a joint model are, of units in their plane and of whole ones alike.

The units' are the first; the mounts' angles, a cosine and a sine of each order of the map, and the play are
the last. What a model has between is its own.

What the choice of orders and the map's figures need of a fit, of planes or of whole units alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np

from calrig.calibration.separation.pose_table import BoolArray, Intp, Table
from calrig.estimation.angles import FloatArray

TURN_DEG = 360.0
HIGHEST_ORDER = 24
LARGEST_RAD = np.radians(8.0)
"""Amplitudes of 0.1° to 8° are on record of real axes."""
LARGEST_BACKLASH_RAD = np.radians(5.0)
ROUND_DEG = 330.0
"""Dial angles over such an arc go round: the orders of the turn come apart."""
SAME_DIAL_DEG = 0.01
GRID_DEG = 2.0


def basis(dial_deg: FloatArray, approach: FloatArray, orders: Sequence[float]) -> FloatArray:
    """(n, 2m + 1) columns of the map: cosine and sine of each order, then half the approach."""
    turn = np.radians(dial_deg)[:, None] * np.asarray(orders, dtype=np.float64)
    waves = np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(len(dial_deg), -1)
    return np.concatenate([waves, 0.5 * approach[:, None]], axis=1)


def goes_round(dial_deg: FloatArray) -> bool:
    """Whether the angles leave no wide gap on the dial."""
    return widest_gap_deg(dial_deg) <= TURN_DEG - ROUND_DEG


def widest_gap_deg(dial_deg: FloatArray) -> float:
    """Of the dial, what no pose stands in."""
    at = np.sort(np.mod(dial_deg, TURN_DEG))
    return float(np.diff(at, append=at[0] + TURN_DEG).max())


def resolved_orders(dial_deg: FloatArray) -> list[float]:
    """Whole orders of a map that such poses can tell, all together."""
    highest = min(HIGHEST_ORDER, told_order(dial_deg), (len(_apart(dial_deg)) - 1) / 2.0)
    return [float(order) for order in range(1, int(highest) + 1)]


def told_order(dial_deg: FloatArray) -> float:
    """The highest order that such poses can tell by itself: half the density of the angles."""
    arc_deg = TURN_DEG - widest_gap_deg(dial_deg)
    spacing_deg = max(arc_deg, SAME_DIAL_DEG) / max(len(_apart(dial_deg)) - 1, 1)
    return (TURN_DEG / spacing_deg - 1.0) / 2.0


def _apart(dial_deg: FloatArray) -> FloatArray:
    """The angles that are not the same, in steps of what is."""
    return np.unique(np.round(np.mod(dial_deg, TURN_DEG) / SAME_DIAL_DEG))


def dial_grid_deg(dial_deg: FloatArray) -> FloatArray:
    """(m,) angles over the part of the dial where poses stood: a turn once, an arc with both its ends."""
    if goes_round(dial_deg):
        return np.arange(-TURN_DEG / 2.0, TURN_DEG / 2.0, GRID_DEG)
    low, high = dial_deg.min(), dial_deg.max()
    if high - low >= TURN_DEG:  # an arc across the turn's end, counted from where no pose stood
        at = np.sort(np.mod(dial_deg, TURN_DEG))
        first = int(np.diff(at, append=at[0] + TURN_DEG).argmax()) + 1
        low = at[first % len(at)]
        high = low + TURN_DEG - widest_gap_deg(dial_deg)
    return np.linspace(low, high, max(round((high - low) / GRID_DEG), 1) + 1)


class Parameters(ABC):
    """p parameters, some of which are to be found.

    Attributes:
        table: the poses.
        orders: of the map; whole numbers, or 360° over a gear's period.
        linear: whether somebody states that the units are.
    """

    __slots__ = ()
    WIDTH: ClassVar[int]
    """Of a unit."""
    table: Table
    orders: tuple[float, ...]
    linear: bool

    @property
    @abstractmethod
    def first_mount(self) -> int:
        """Place of the first mount's angle."""

    @property
    @abstractmethod
    def free(self) -> BoolArray:
        """(p,) which parameters are to be found; the others are 0."""

    @property
    @abstractmethod
    def blocks(self) -> tuple[Intp, ...]:
        """Places of what is free beside the map, in blocks that touch one another by the map alone."""

    @abstractmethod
    def widths(self) -> FloatArray:
        """(p,) how large each may be: what is known of it before the data, as a standard deviation."""

    @abstractmethod
    def start(self) -> FloatArray:
        """(p,) where to begin."""

    def unit_at(self, unit: int) -> slice:
        """Places of one unit."""
        return slice(self.WIDTH * unit, self.WIDTH * (unit + 1))

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
        """Places of the map, play and all."""
        return slice(self.first_order, self.size)

    def tells_play(self) -> bool:
        """Whether poses were approached from both sides."""
        approach = self.table.approach
        return len(np.unique(approach[approach != 0.0])) > 1

    def widths_of_stage(self) -> FloatArray:
        """As `widths`, of the mounts' angles and the map."""
        of_mounts = np.full(len(self.table.mounts), np.pi)
        of_map = np.full(2 * len(self.orders), LARGEST_RAD)
        return np.concatenate([of_mounts, of_map, [LARGEST_BACKLASH_RAD]])

    def title_on_map(self, place: int) -> str:
        """What a parameter of the map is."""
        if place == self.size - 1:
            return "the play"
        return f"order {self.orders[(place - self.first_order) // 2]:g} of the stage"


class NormalEquations(Protocol):
    """Weighted, about some parameters: JᵀWJ and JᵀWr."""

    @property
    def matrix(self) -> FloatArray: ...  # noqa: D102
    @property
    def gradient(self) -> FloatArray: ...  # noqa: D102


class Linearised(Protocol):
    """A fit with its normal equations; attributes as `least_squares.Fit` has them."""

    @property
    def problem(self) -> Parameters: ...  # noqa: D102
    @property
    def parameters(self) -> FloatArray: ...  # noqa: D102
    def covariance_of(self, rows: FloatArray) -> FloatArray: ...  # noqa: D102
    def covariance_at(self, places: Intp) -> FloatArray: ...  # noqa: D102
    @property
    def noise(self) -> float: ...  # noqa: D102
    @property
    def freedom(self) -> float: ...  # noqa: D102
    @property
    def normal(self) -> NormalEquations: ...  # noqa: D102
    @property
    def kept(self) -> BoolArray: ...  # noqa: D102
