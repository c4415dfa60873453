"""Use cases of a rig's stage map: which one is in force, what a run stores of it, and whether it is valid.

A map that was put in force (`POST /api/rigs/{name}/map`) precedes the file that the configuration names. Once
it is withdrawn, the file is in force again.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.solutions import mounted, usable_map
from calrig.calibration.separation import CHECKED_ORDERS as ORDERS
from calrig.calibration.separation import MapCheck, MapError, StageMap, checked, in_words
from calrig.calibration.uncertainty import deg, percent
from calrig.settings import RigSettings, Settings, SettingsError
from calrig.store import Run, Store
from calrig.store.records import Document
from calrig.store.rigs import MapInForce

LOOKS_BACK = 100
"""Of a rig's newest runs, so many are looked at."""


def holds(store: Store, rig: str, kept: Document) -> Document:
    """Whether the map in force still fits, by the newest run that can tell.

    A run of the check unit tells where the rig has one; else the newest of any unit that was on the rig when
    the map was made, or since. The newest such run is compared with the earliest.

    `kept` is what runs keep of the map in force.
    """
    stage_map, named = StageMap.from_frozen(kept), store.check_standards.of(rig)
    runs, _ = store.runs.page(rig=rig, status="completed", limit=LOOKS_BACK)
    guards = [run for run in runs if run.voided is None and (named is None or run.unit == named.unit)]
    for now, before in _pairs(guards, stage_map):
        found = _held(store, now, before, stage_map)
        if found is not None:
            return _document(now, before, found)
    who = "the same unit" if named is None else f"check unit {named.unit}"
    says = f"Map stability: not yet checked. Measure {who} again, two sweeps each way."
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
            "solve again."
        )
    else:
        seen = (f"order {k} from {deg(size)}" for k, size in zip(ORDERS, found.seen_from_deg, strict=True))
        says = (
            f"The map holds: by {told}, nothing is off by more than {largest}. Such runs show a change (RMS) "
            f"of {', '.join(seen)} on."
        )
    return {
        "state": "moved" if found.has_moved else "holds",
        "says": says,
        "unit": now.unit,
        "run_id": now.id,
        "baseline_run_id": before.id,
        "p_value": found.p_value,
        "largest_deg": found.largest_deg,
        "largest_at_deg": found.largest_at_deg,
        "at_deg": list(found.at_deg) if found.has_moved else [],
    }


def configured_maps(settings: Settings) -> dict[str, Document]:
    """What runs are to keep of the maps that the configuration names, by rig; looked at when it starts.

    Raises:
        SettingsError: a file cannot be read or is no map that can be used, and what to do.
    """
    return {rig.name: kept for rig in settings.rig if (kept := _of_file(settings, rig)) is not None}


def _of_file(settings: Settings, rig: RigSettings) -> Document | None:
    named = None if rig.reference is None else rig.reference.map
    if named is None:
        return None
    file = (settings.file.parent if settings.file else Path()) / named
    where = f"{settings.file}: rig {rig.name!r}, reference.map: {file}"
    again = "make it again with `calrig solve … --out DIR`, or leave `map` out"
    try:
        document = json.loads(file.read_text(encoding="utf-8"), parse_constant=_refuse)
        stage_map = StageMap.from_document(document)
    except OSError as error:
        said = f"cannot be read ({error.strerror}): name the stage-map.json of `calrig solve … --out DIR`"
        raise SettingsError(f"{where} {said}") from error
    except MapError as error:
        raise SettingsError(f"{where} {error}: {again}") from error
    except ValueError as error:
        raise SettingsError(f"{where} is no JSON document ({error}): {again}") from error
    return {**stage_map.frozen(), "solve": None, "file": named, "solved_at": None, "put_at": None}


def _refuse(name: str) -> Any:
    raise MapError(f"has a number in it that is not finite ({name})")


def kept_of(store: Store, rig: str, configured: Mapping[str, Document]) -> Document | None:
    """What a run that begins now on a rig keeps of the map in force; None where there is none.

    `configured` is as of `configured_maps`.
    """
    found = store.stage_maps.of(rig)
    return configured.get(rig) if found is None else _kept(store, found)


def provenance_part(store: Store, rig: str, configured: Mapping[str, Document]) -> Document:
    """The same as a part of a new run's provenance; nothing of it where there is no map."""
    kept = kept_of(store, rig, configured)
    return {} if kept is None else {"stage_map": kept}


def _kept(store: Store, found: MapInForce) -> Document:
    solved_at = store.solutions.get(found.solution_id).created_at
    return {
        **StageMap.from_document(found.document).frozen(),
        "solve": found.solution_id,
        "file": None,
        "solved_at": solved_at.isoformat(timespec="seconds"),
        "put_at": found.put_at.isoformat(timespec="seconds"),
    }


def put_in_force(store: Store, rig: str, solution_id: str, *, who: str | None) -> MapInForce:
    """Puts the map of a stored solution in force for a rig.

    Raises:
        NotFound: there is no such solution.
        Conflict: it is of another rig, or its map cannot be used, and why.
    """
    solution = store.solutions.get(solution_id)
    if solution.found.rig != rig:
        raise Conflict(
            f"solution {solution_id} is of rig {solution.found.rig!r}: each stage has a map of its own"
        )
    usable_map(solution)
    return store.stage_maps.put_in_force(rig, solution_id, solution.found.stage_map, who=who)


def listed_maps(store: Store, configured: Mapping[str, Document]) -> list[Document]:
    """Which maps are in force, by name of the rig."""
    put = {
        one.rig: {"rig": one.rig, "sha256": one.sha256, "solve": one.solution_id, "file": None}
        for one in store.stage_maps.all()
    }
    of_files = {
        rig: {"rig": rig, "sha256": kept["sha256"], "solve": None, "file": kept["file"]}
        for rig, kept in configured.items()
    }
    return [one for _, one in sorted({**of_files, **put}.items())]


def shown_map(store: Store, rig: RigSettings, configured: Mapping[str, Document]) -> Document:
    """The map in force for a rig, as people and programs look at it.

    Raises:
        Unknown: it has none.
    """
    kept, found = kept_of(store, rig.name, configured), store.stage_maps.of(rig.name)
    if kept is None:
        of_bench = "; its bench may have a file of its own" if rig.reference and rig.reference.map else ""
        raise Unknown(f"rig {rig.name!r} has no stage's map in force{of_bench}")
    stage_map = StageMap.from_frozen(kept)
    dial_deg = stage_map.known_deg
    middle = np.zeros(len(dial_deg))
    return {
        "rig": rig.name,
        **{key: kept[key] for key in ("solve", "file", "sha256", "solved_at", "put_at", "std_deg")},
        "put_by": None if found is None else found.put_by,
        "dial_deg": (float(dial_deg[0]), float(dial_deg[-1])),
        "orders": list(stage_map.orders),
        "coefficients_deg": stage_map.coefficients_deg.tolist(),
        "covariance_deg2": stage_map.covariance_deg2.tolist(),
        "map": {
            "stage_deg": dial_deg.tolist(),
            "error_deg": stage_map.correction_deg(dial_deg, middle).tolist(),
            "std_deg": stage_map.stds_deg(dial_deg, middle).tolist(),
        },
        "units": list(stage_map.units),
        "runs": list(stage_map.sources),
        "holds": holds(store, rig.name, kept),
        "says": f"Elevations rest on {in_words(kept)}.",
    }
