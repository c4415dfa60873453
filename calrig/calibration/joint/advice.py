"""Which mounts would help, and by how much: from the bound, never from a rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.bound import mounted_otherwise
from calrig.calibration.joint.solution import Solution

SEVENTH_DEG = 360.0 / 7.0
PLANS_DEG = (
    (0.0, 90.0),
    (0.0, 120.0, 240.0),
    (0.0, 90.0, 225.0),
    (0.0, SEVENTH_DEG, 3.0 * SEVENTH_DEG),
)
"""From the fewest mounts on: 0/90° parts all orders but 4, 8, …; 0/120/240° all but 3, 6, …; 0/90/225° all
but 8, 16, …; sevenths all but 7, 14, ….
"""
WORTH_IT = 1.5
"""By how much the elevation must be known better for a unit to be clamped anew."""
AS_GOOD = 1.1
"""A plan is as good as another within this; the one of fewer mounts, or named first, is then advised."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Mounts that would help, and the elevation's standard error now and then, degrees."""

    mounts_deg: tuple[float, ...]
    now_deg: float
    then_deg: float
    says: str


def advised(solution: Solution) -> Advice | None:
    """The plan of mounts to take the unit to that is known least; None where none would help."""
    unit = int(np.argmax([worth.rms_deg for worth in solution.worths]))
    now_deg = solution.worths[unit].rms_deg
    table = solution.table
    own = np.flatnonzero((table.unit == unit) & solution.fit.kept)
    rows = own[table.mount[own] == np.bincount(table.mount[own]).argmax()]
    then = {plan: mounted_otherwise(solution.fit, unit, rows, plan).rms_deg for plan in PLANS_DEG}
    least = min(then.values())
    plan, then_deg = next((plan, std) for plan, std in then.items() if std <= AS_GOOD * least)
    if now_deg < WORTH_IT * then_deg:
        return None
    angles = ", ".join(f"{angle:.4g}°" for angle in plan)
    return Advice(
        plan,
        now_deg,
        then_deg,
        f"unit {table.units[unit]} clamped at {angles}, each with the {len(rows)} dial angles of its largest "
        f"mount: the elevation would be known to {then_deg:.2g}° in place of {now_deg:.2g}°",
    )
