"""Where the parameters of a joint model are, of units in their plane and of whole ones alike.

The units' are the first; the mounts' angles, a cosine and a sine of each order of the map, and the play are
the last. What a model has between is its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from calrig.calibration.joint.stage_map import LARGEST_BACKLASH_RAD, LARGEST_RAD
from calrig.calibration.joint.table import BoolArray, Intp, Table
from calrig.estimation.angles import FloatArray


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
