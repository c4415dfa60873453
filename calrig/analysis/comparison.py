"""Units side by side: their runs, how each unit drifts, and what sets units apart from repeatability."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from calrig.analysis.errors import Unknown
from calrig.calibration.compare import Components, components, drift
from calrig.store import ComparisonRow, Store

Row = dict[str, Any]

FEWEST_REPEATS = 3
"""Runs beyond each unit's first; fewer say too little of the repeatability to hold the spread against it."""
FAR_APART = 3.0
"""Times the repeatability, from where on one calibration for all units would be the larger error."""


def compared_runs(store: Store, serials: Sequence[str] | None) -> dict[str, list[Row]]:
    """The completed, not voided calibrations of each unit, the oldest first.

    Args:
        store: where they are.
        serials: units in the order wanted; None for all.

    Raises:
        Unknown: there is no such unit.
    """
    known = dict.fromkeys(unit.serial for unit in store.units())
    for serial in serials or ():
        if serial not in known:
            raise Unknown(f"there is no unit {serial!r}")
    units: dict[str, list[Row]] = {serial: [] for serial in serials or known}
    effects = store.effect_names()
    for row in store.comparison(serials or None):
        units[row.unit].append(_row(row, effects))
    return units


def comparison(units: Mapping[str, Sequence[Row]]) -> Row:
    """CONTRACT section 2's comparison of what `compared_runs` gives."""
    drifting = [
        {"unit": serial, "runs": runs, "drift_deg_per_day": _drift(runs)} for serial, runs in units.items()
    ]
    spread = {figure: _spread(list(units.values()), figure) for figure in ("bias_deg", "scale")}
    return {"units": drifting, "spread": spread}


def _row(row: ComparisonRow, effects: Mapping[str, list[str]]) -> Row:
    corrected = row.result["rms_with_effects_deg"] is not None
    return {
        "run_id": row.run_id,
        "finished_at": row.finished_at,
        **row.result,
        "effects": effects.get(row.unit, []) if corrected else [],
    }


def _drift(runs: Sequence[Row]) -> float | None:
    found = drift([run["finished_at"] for run in runs], [run["bias_deg"] for run in runs])
    return found.deg_per_day if found else None


def _spread(units: Sequence[Sequence[Row]], figure: str) -> Row:
    known = [(k, run[figure]) for k, runs in enumerate(units) for run in runs if run[figure] is not None]
    found = components([k for k, _ in known], [value for _, value in known])
    counts = Counter(k for k, _ in known)
    says = _compared(found, repeats=sum(counts.values()) - len(counts))
    return {"between_units_std": found.between, "within_unit_std": found.within, "says": says}


def _compared(found: Components, repeats: int) -> str:
    """What the spread between units means beside the repeatability of one."""
    between, within = found.between, found.within
    if within is None:
        return "A unit needs two runs or more for its repeatability."
    if between is None:
        return "Two units or more are needed for the spread between units."
    if repeats < FEWEST_REPEATS:
        return "There are too few repeated runs yet to compare the two."
    if between <= within:
        return "The spread between units is no larger than the repeatability."
    if within == 0.0 or between <= FAR_APART * within:
        return "The spread between units is somewhat larger than the repeatability."
    times = f"{between / within:.0f} times the repeatability"
    return f"The spread between units is {times}: each unit needs its own calibration."
