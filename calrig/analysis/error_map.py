"""The rig's error map: stage, mounts and units solved together over the rig's newest runs.

A mean over units, whichever way it is taken, holds what units have in common as well (0.12–0.15° of a usual
stage). Gravity tells the two apart once one unit among them was clamped at several angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calrig.analysis.solutions import mounted
from calrig.analysis.stored_runs import ended_run
from calrig.calibration.poses import DiagnosisError
from calrig.calibration.separation import MountedPoses, StageMap
from calrig.model.solution import ErrorMap

if TYPE_CHECKING:
    from calrig.calibration.separation import Solution
    from calrig.store import Store


MOST_RUNS = 12
"""The newest; solved in some seconds."""
LOOKS_BACK = 100
"""Of the rig's newest runs, among which those of units that were clamped otherwise go first."""


@dataclass(frozen=True, slots=True)
class Basis:
    """The runs that a map rests on: their ids, and how many poses of each count."""

    runs: tuple[tuple[str, int], ...]
    units: int


def basis_of(store: Store, rig: str) -> Basis:
    """The newest runs of a rig that count, at most `MOST_RUNS`; those at several clamping angles first."""
    runs, _ = store.runs.page(rig=rig, status="completed", limit=LOOKS_BACK)
    counted = [run for run in runs if run.voided is None and run.kind != "static"]
    # any angle but 0 is a clamping otherwise than usual
    chosen = sorted(counted, key=lambda run: not any((run.plan or {}).get("mounts_deg") or ()))[:MOST_RUNS]
    numbers = ((run.id, store.poses.count(run.id)) for run in chosen)
    return Basis(tuple(one for one in numbers if one[1]), len({run.unit for run in chosen}))


def poses_by_mounting(store: Store, basis: Basis) -> list[MountedPoses]:
    """The poses that a map rests on."""
    return mounted(store, [ended_run(store, run_id) for run_id, _ in basis.runs])


def solved_map(lots: Sequence[MountedPoses], basis: Basis) -> ErrorMap:
    """The map of these poses; takes some seconds.

    `lots` are the poses of each clamping, `basis` is what they are of.
    """
    # a tenth of a second that a service need not start with
    from calrig.calibration.separation import advised, solve

    if not lots:
        return _untold(basis, "the rig has no completed run")
    try:
        solution = solve(lots)
    except DiagnosisError as error:
        return _untold(basis, str(error))
    if not all(solution.is_separable(unit) for unit in range(len(solution.table.units))):
        advice = advised(solution)
        helps = "" if advice is None else f": {advice.says}"
        return _untold(basis, f"these runs do not part the stage from the units on it{helps}")
    return _told(solution, basis)


def _untold(basis: Basis, why: str) -> ErrorMap:
    says = f"Not known yet: {why}."
    return ErrorMap(stage_deg=[], approach=[], error_deg=[], std_deg=[], units=basis.units, says=says)


def _told(solution: Solution, basis: Basis) -> ErrorMap:
    from calrig.export.solution_documents import stage_map_document

    stage_map = StageMap.from_document(stage_map_document(solution))
    senses = (1, -1) if solution.fit.problem.free[-1] else (0,)
    dial = np.tile(stage_map.known_deg, len(senses))
    approach = np.repeat(senses, len(stage_map.known_deg))
    n_runs = "1 run" if len(basis.runs) == 1 else f"the newest {len(basis.runs)} runs"
    return ErrorMap(
        stage_deg=dial.tolist(),
        approach=approach.tolist(),
        error_deg=stage_map.correction_deg(dial, approach).tolist(),
        std_deg=stage_map.stds_deg(dial, approach).tolist(),
        units=basis.units,
        says=f"Solved together with the units from {n_runs}; its mean over the dial is the clamping's.",
    )
