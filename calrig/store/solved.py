"""A joint solution before it has an id. It does not depend on the tables."""

from __future__ import annotations

from dataclasses import dataclass

from calrig.model.solution import Frame
from calrig.store.records import Document


@dataclass(frozen=True, slots=True)
class Basis:
    """What a solution rests on.

    Attributes:
        runs: ids of the runs, all of one rig.
        units: serials of their units.
        linear: whether the units were stated to have no quadratic and cubic terms.
        periods_deg: of gears that somebody knew.
        seat_std_deg: how far one clamping was said to scatter from the next; None where nobody did.
        frame: of units clamped by several faces, whose their matrix is.
    """

    runs: tuple[str, ...]
    units: tuple[str, ...]
    linear: bool = False
    periods_deg: tuple[float, ...] = ()
    seat_std_deg: float | None = None
    frame: Frame = "sensor"


@dataclass(frozen=True, slots=True)
class Solved:
    """A joint solution as it leaves the arithmetic.

    Attributes:
        rig: whose stage it is of; None where the runs name none.
        basis: what it rests on.
        document: CONTRACT section 8.
        calibrations: CONTRACT section 6 by serial, with the uncertainty of this solution.
        stage_map: what `stage-map.json` has.
        poses: equally long columns for the picture (`calrig.figures.joint`).
    """

    rig: str | None
    basis: Basis
    document: Document
    calibrations: dict[str, Document]
    stage_map: Document
    poses: Document

    @property
    def is_whole(self) -> bool:
        """Whether the units were clamped by several faces."""
        return any(mount["mount_axis"][-1] != "x" for mount in self.document["mounts"])
