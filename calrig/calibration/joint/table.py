"""Poses of any number of mounts and units, as the joint solution takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray

BoolArray = npt.NDArray[np.bool_]
Intp = npt.NDArray[np.intp]


SENSES = {"x": 1, "+x": 1, "-x": -1}
"""Of the unit's elevation against the dial's angle, by the axis that lies along the stage's."""


@dataclass(frozen=True, slots=True)
class Mounted:
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
