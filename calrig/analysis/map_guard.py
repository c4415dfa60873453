"""The guard of a rig's map: its check unit, or whichever unit came back to the rig."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

from calrig.analysis.joint_solutions import mounted
from calrig.calibration.separation import MapCheck, StageMap, checked
from calrig.calibration.uncertainty import deg, percent
from calrig.store import Run, Store
from calrig.store.records import Document

LOOKS_BACK = 100
"""Of a rig's newest runs, so many are looked at."""


def holds(store: Store, rig: str, kept: Document) -> Document:
    """Whether the map in force still fits, by the newest run that can tell.

    A run of the check unit tells where the rig has one; else the newest of any unit that was on the rig when
    the map was made, or since. The earliest such run is what the newest is held against.

    Args:
        store: has the runs.
        rig: by name.
        kept: what runs keep of the map in force.
    """
    stage_map, named = StageMap.from_frozen(kept), store.check_unit(rig)
    runs, _ = store.runs(rig=rig, status="completed", limit=LOOKS_BACK)
    guards = [run for run in runs if run.voided is None and (named is None or run.unit == named.unit)]
    for now, before in _pairs(guards, stage_map):
        found = _held(store, now, before, stage_map)
        if found is not None:
            return _document(now, before, found)
    who = "a unit" if named is None else f"check unit {named.unit}"
    says = (
        f"Not known: it takes {who} that was on this rig when the map was made, or since, and again after; "
        "two sweeps each way, over the same elevations."
    )
    nothing = dict.fromkeys(("unit", "run_id", "baseline_run_id", "p_value", "largest_deg", "largest_at_deg"))
    return {"state": "not_known", "says": says, **nothing, "at_deg": []}


def _pairs(runs: Sequence[Run], stage_map: StageMap) -> Iterator[tuple[Run, Run]]:
    """Runs by the map with the earliest of their unit that belongs to it, the newest first."""
    earliest: dict[str, Run] = {}
    for run in runs:  # newest first, so that the earliest is kept
        if run.id in stage_map.sources or _is_by(run, stage_map):
            earliest[run.unit] = run
    for run in runs:
        if _is_by(run, stage_map) and earliest[run.unit].id != run.id:
            yield run, earliest[run.unit]


def _is_by(run: Run, stage_map: StageMap) -> bool:
    return (run.provenance.get("stage_map") or {}).get("sha256") == stage_map.sha256


def _held(store: Store, now: Run, before: Run, stage_map: StageMap) -> MapCheck | None:
    """By the first clamping angle that both runs have and that tells."""
    then = {(lot.nominal_deg or 0.0, lot.axis): lot.poses for lot in mounted(store, [before])}
    for lot in mounted(store, [now]):
        same = then.get((lot.nominal_deg or 0.0, lot.axis))
        found = None if same is None else checked(lot.poses, same, stage_map)
        if found is not None:
            return found
    return None


def _document(now: Run, before: Run, found: MapCheck) -> Document:
    largest = f"{deg(abs(found.largest_deg))} near {found.largest_at_deg:g}° of the dial".replace("-", "−")
    told = f"unit {now.unit} in run {now.id}, against run {before.id}"
    if found.has_moved:
        says = (
            f"The map has moved: by {told}, the stage is off by up to {largest}, which noise and the "
            f"map's uncertainty give in {percent(found.p_value)} of cases. Clamp a unit at three angles, and "
            "solve anew."
        )
    else:
        says = f"The map holds: by {told}, nothing is off by more than {largest}."
    return {
        "state": "moved" if found.has_moved else "holds",
        "says": says,
        "unit": now.unit,
        "run_id": now.id,
        "baseline_run_id": before.id,
        **asdict(found),
        "at_deg": list(found.at_deg) if found.has_moved else [],
    }
