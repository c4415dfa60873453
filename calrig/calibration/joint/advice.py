"""Which mounts would help, and by how much: from the bound, never from a rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.bound import mounted_otherwise
from calrig.calibration.joint.solution import Solution
from calrig.calibration.joint.stage_map import SAME_DIAL_DEG, TURN_DEG
from calrig.estimation.angles import FloatArray

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
WIDER = 1.1
AS_GOOD = 1.1
"""A plan is as good as another within this; the one of fewer mounts, or named first, is then advised."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Mounts that would help, and the elevation's standard error now and then, degrees."""

    mounts_deg: tuple[float, ...]
    now_deg: float
    then_deg: float
    says: str


def advised(solution: Solution, limits_deg: tuple[float, float] | None = None) -> Advice | None:
    """The plan of mounts to take the unit to that is known least; None where none would help.

    Args:
        solution: of what was taken so far.
        limits_deg: of the dial; without them no angle is advised beyond those of the poses.
    """
    unit = int(np.argmax([worth.rms_deg for worth in solution.worths]))
    now_deg = solution.worths[unit].rms_deg
    table = solution.table
    own = np.flatnonzero((table.unit == unit) & solution.fit.kept)
    rows = own[table.mount[own] == np.bincount(table.mount[own]).argmax()]
    dials = [table.dial_deg[rows], *_over(table.dial_deg[rows], limits_deg)]
    then = [
        (mounted_otherwise(solution.fit, unit, rows, plan, dial).rms_deg, plan, dial)
        for plan in PLANS_DEG
        for dial in dials
    ]
    least = min(std for std, _, _ in then)
    then_deg, plan, dial = next(one for one in then if one[0] <= AS_GOOD * least)
    if now_deg < WORTH_IT * then_deg:
        return None
    angles = ", ".join(f"{angle:.4g}°" for angle in plan)
    return Advice(
        plan,
        now_deg,
        then_deg,
        f"unit {table.units[unit]} clamped at {angles}, each with {len(rows)} poses from {dial.min():.4g}° "
        f"to {dial.max():.4g}° of the dial: the elevation would be known to {then_deg:.2g}° in place of "
        f"{now_deg:.2g}°",
    )


def _over(dial_deg: FloatArray, limits_deg: tuple[float, float] | None) -> list[FloatArray]:
    """The dial angles spread over what the stage is allowed, where that is wider; a turn at most."""
    if limits_deg is None:
        return []
    low, high = limits_deg
    if high - low > TURN_DEG:
        low, high = 0.5 * (low + high - TURN_DEG), 0.5 * (low + high + TURN_DEG)
    if high - low < WIDER * np.ptp(dial_deg):
        return []
    return [low + (dial_deg - dial_deg.min()) * (high - low) / max(float(np.ptp(dial_deg)), SAME_DIAL_DEG)]
