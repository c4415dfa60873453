"""Units side by side: their runs, how each drifts and changed, what sets units apart, and their pictures."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from pydantic_core import to_json

from calrig import figures
from calrig.analysis.check_standard import suspects
from calrig.analysis.due_dates import DueDates, due_dates
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import RULE, Histories, change_of, change_verdict, histories
from calrig.analysis.stored_runs import counted_poses
from calrig.calibration.histories import (
    FALSE_DISCOVERY_RATE,
    Components,
    Repeatability,
    components,
    drift_deg_per_day,
)
from calrig.store import ComparisonRow, Store
from calrig.store.issued import Revision

Row = dict[str, Any]

FEWEST_REPEATS = 3
"""Runs beyond each unit's first; fewer say too little of the repeatability to hold the spread against it."""
FAR_APART = 3.0
"""Times the repeatability, from where on one calibration for all units would be the larger error."""
MOST_NAMED = 5
"""Units that a sentence names one by one."""


def compared_runs(store: Store, serials: Sequence[str] | None, found: Histories) -> dict[str, list[Row]]:
    """The calibrations of each unit that count, the oldest first.

    `serials` are units in the order wanted, None for all; `found` are all histories.

    Raises:
        Unknown: there is no such unit.
    """
    known = dict.fromkeys(unit.serial for unit in store.units.all(serials))
    for serial in serials or ():
        if serial not in known:
            raise Unknown(f"there is no unit {serial!r}")
    units: dict[str, list[Row]] = {serial: [] for serial in serials or known}
    effects = store.effects.names_by_unit()
    in_doubt = suspects(store, found)
    for row in found.rows:
        if row.unit in units:
            units[row.unit].append(_row(row, effects) | {"suspect": in_doubt.of(row.rig, row.finished_at)})
    return units


def figures_in_force(store: Store, serials: Sequence[str] | None) -> dict[str, Row]:
    """Return the figures of each unit's revision in force, by serial number; of all units for None."""
    return {one.unit: _figures(one) for one in store.revisions.all_in_force(serials)}


def _figures(revision: Revision) -> Row:
    document = revision.document
    is_solved = "elevation_std_deg" in document
    stds: list[float | None] = [None, None]
    if document["covariance"] is not None and not is_solved:
        stds = [math.sqrt(max(document["covariance"][k][k], 0.0)) for k in range(2)]
    with_effects = document["rms_with_effects_deg"]
    return {
        "revision": revision.revision,
        "run_id": revision.run_id,
        "bias_deg": document["bias_deg"] if document["level_known"] or not is_solved else None,
        "bias_std_deg": document["level_std_deg"] if is_solved else stds[0],
        "scale": document["scale"],
        "scale_std": stds[1],
        "rms_deg": document["rms_calibrated_deg"] if with_effects is None else with_effects,
        "effects": [effect["name"] for effect in document["effects"]],
        "answer": revision.verdict["answer"],
        "left": revision.verdict["left"],
    }


def comparison(
    found: Histories, units: Mapping[str, Sequence[Row]], due: DueDates, in_force: Mapping[str, Row]
) -> Row:
    """CONTRACT section 2's comparison of what `compared_runs` gives, the units that changed first.

    `in_force` is that of `figures_in_force`.
    """
    significance, most = _significance(found)
    changed = {serial for serial, k in most.items() if found.changes.changed[k]}
    drifting = [
        {
            "unit": serial,
            "runs": runs,
            "in_force": in_force.get(serial),
            "drift_deg_per_day": drift_deg_per_day(
                [run["finished_at"] for run in runs], [run["bias_deg"] for run in runs]
            ),
            "p_value": significance.get(serial),
            "changed": serial in changed,
            "verdict": change_verdict(significance.get(serial), changed=serial in changed),
            "change": change_of(found, most[serial]) if serial in most else None,
            **asdict(due.of(serial)),
        }
        for serial, runs in units.items()
    ]
    drifting.sort(key=lambda one: (not one["changed"], one["p_value"] if one["changed"] else 0.0))
    apart = [one["unit"] for one in drifting if one["changed"]]
    return {
        "units": drifting,
        "spread": {figure: _spread(found, units, figure, apart) for figure in ("bias_deg", "scale")},
        "repeatability": {
            "bias_deg": _repeats(found.changes.pooled[0]),
            "scale": _repeats(found.changes.pooled[1]),
            "false_discovery_rate": FALSE_DISCOVERY_RATE,
            "rule": RULE,
            "says": _marked(apart, len(units), known=any(one is not None for one in found.changes.pooled)),
        },
    }


def comparison_json(serials: Sequence[str] | None, interval_days: float, store: Store) -> bytes:
    """Return the comparison of units as JSON, made from the store.

    `serials` are in the order wanted, None for all; a unit is due after `interval_days`, unless its drift
    says otherwise.

    Raises:
        Unknown: there is no such unit.
    """
    found = histories(store, serials)
    due = due_dates(store, found, serials=serials, interval_days=interval_days)
    in_force = figures_in_force(store, serials)
    document = comparison(found, compared_runs(store, serials, found), due, in_force)
    return to_json(document, inf_nan_mode="null")


def _significance(found: Histories) -> tuple[dict[str, float | None], dict[str, int]]:
    """Each unit's p-value, and the place of its most significant difference."""
    p_values = {
        serial: float(p) if math.isfinite(p) else None
        for serial, p in zip(found.serials, found.changes.unit_p_value, strict=True)
    }
    places = np.argsort(-np.nan_to_num(found.changes.p_value, nan=2.0), kind="stable")
    units = found.figures[0].unit[found.changes.first[places]]
    return p_values, {found.serials[unit]: int(k) for unit, k in zip(units, places, strict=True)}


def _row(row: ComparisonRow, effects: Mapping[str, list[str]]) -> Row:
    corrected = row.result["rms_with_effects_deg"] is not None
    return {
        "run_id": row.run_id,
        "finished_at": row.finished_at,
        **row.result,
        "effects": effects.get(row.unit, []) if corrected else [],
    }


def _spread(
    histories: Histories, units: Mapping[str, Sequence[Row]], figure: str, apart: Sequence[str]
) -> Row:
    """A unit that changed counts as one before and as another one after: it says nothing of repeatability."""
    segments = zip((row.run_id for row in histories.rows), histories.segment().tolist(), strict=True)
    segment = dict(segments)
    known = [
        (segment[run["run_id"]], run[figure])
        for runs in units.values()
        for run in runs
        if run[figure] is not None
    ]
    places = {one: place for place, one in enumerate(dict.fromkeys(k for k, _ in known))}
    found = components([places[k] for k, _ in known], [value for _, value in known])
    counts = Counter(k for k, _ in known)
    says = _compared(found, repeats=sum(counts.values()) - len(counts))
    if apart:
        says = f"{says} {_listed(apart)} changed: before and after count apart."
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


def _repeats(pooled: Repeatability | None) -> Row | None:
    if pooled is None:
        return None
    return {
        "reclamping_std": pooled.run,
        "day_std": pooled.day,
        "rig_std": pooled.rig,
        "freedom": pooled.freedom,
    }


def _marked(apart: Sequence[str], units: int, *, known: bool) -> str:
    if not known:
        return (
            "Whether a unit changed is not known yet: that takes units that were calibrated more than once, "
            "to know the remounting and between-day components."
        )
    if not apart:
        return "No unit changed by more than repeatability."
    return f"Changed by more than repeatability: {_listed(apart)} ({len(apart)} of {units})."


def _listed(serials: Sequence[str]) -> str:
    more = len(serials) - MOST_NAMED
    return ", ".join(serials[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


ComparedFigure = Literal["bias", "scale", "rms", "residuals"]


def compared_figure(
    name: ComparedFigure, serials: Sequence[str] | None, chosen: Sequence[str] | None, store: Store
) -> figures.Figure:
    """Return a picture of units.

    `serials` are in the order wanted, None for all; units that are not dimmed are `chosen`, without any those
    that changed.

    Raises:
        Unknown: there is no such unit.
    """
    found = histories(store, serials)
    units = compared_runs(store, serials, found)
    coloured = chosen or found.changed_units()
    if name != "residuals":
        return figures.compare(name, units, coloured)
    latest = {serial: runs[-1] for serial, runs in units.items() if runs}
    curves = [
        figures.Curve(serial, counted_poses(store, run["run_id"]), run["bias_deg"], run["scale"])
        for serial, run in latest.items()
    ]
    return figures.residuals_overlaid(curves, coloured)
