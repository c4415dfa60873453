"""Poses of any number of mounts and units, as the joint solution takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray

BoolArray = npt.NDArray[np.bool_]
Intp = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Mounted:
    """Poses of one unit, taken without it being touched.

    Attributes:
        unit: serial number.
        mount: a label.
        nominal_deg: the angle at which it was clamped, as somebody said; None where nobody did.
        source: the file or run they are of.
        axis: which of the unit's axes lies along the stage's.
    """

    unit: str
    mount: str
    nominal_deg: float | None
    source: str
    poses: Sequence[Pose]
    axis: str = "x"


@dataclass(frozen=True, slots=True)
class Mount:
    """One clamping: its label, its unit by index, and the angle that was stated, degrees."""

    name: str
    unit: int
    nominal_deg: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """n poses in columns.

    Attributes:
        units: serial numbers.
        mounts: each clamping.
        sources: files or runs; `source` (n,) has the index of each pose's.
        mount: (n,) index of each pose's mount.
        dial_deg: (n,) the stage's own angle.
        approach: (n,) +1 or −1; 0 where it is not known.
        warmer_c: (n,) die temperature less its unit's reference; 0 where it is not known.
        reference_c: (units,) that reference, NaN where the unit's temperature is not known or never changed.
        vector_g: (n, 2) a_y and a_z; NaN where the pose has the reading alone.
        reading: (n,) the elevation read, rad.
        in_order: whether the poses of each source and mount come in the order measured.
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

    def __len__(self) -> int:
        return len(self.dial_deg)

    @property
    def unit(self) -> Intp:
        """(n,) index of each pose's unit."""
        return np.array([mount.unit for mount in self.mounts], dtype=np.intp)[self.mount]

    @property
    def has_vector(self) -> BoolArray:
        """(n,) whether a pose has the accelerometer's means."""
        return np.asarray(np.isfinite(self.vector_g).all(axis=1))

    def angle(self) -> FloatArray:
        """(n,) the accelerometer's angle, else the reading, rad."""
        seen = np.arctan2(self.vector_g[:, 0], self.vector_g[:, 1])
        return np.where(self.has_vector, seen, self.reading)

    def rows(self, chosen: Intp | BoolArray) -> Table:
        """The same mounts with some of the poses."""
        names = ("source", "mount", "dial_deg", "approach", "warmer_c", "vector_g", "reading")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})
