"""What a joint solution leaves behind: each unit's calibration (CONTRACT section 6), and the stage's map."""

from __future__ import annotations

from typing import Any

from calrig.calibration.separation import NAMES, Solution, level_document, parameters_of
from calrig.export.solved_parts import calibration, effects_of_values, stage_map


def unit_document(solution: Solution, unit: int, rig: str | None = None) -> dict[str, Any]:
    """A unit's calibration with the uncertainty of this solution: nothing in it rests on the stage's word.

    All that the unit does to a vector is in its effects, beside a scale of 1; the bias is its level, where a
    reversal tells it, and 0 where none does: the sensor's axes err at their own elevation, which is bias + θ.
    """
    level = solution.known_level(unit)
    own = {
        "bias_deg": 0.0 if level is None else level.value_deg,
        "effects": effects_of(solution, unit),
        "level_known": level is not None,
        "level_std_deg": None if level is None else level.std_deg,
    }
    provenance = {
        "separable": solution.is_separable(unit),
        "level": None if level is None else level_document(level),
    }
    return calibration(solution, unit, solution.measurand(unit), own, provenance, rig)


def effects_of(solution: Solution, unit: int) -> list[dict[str, Any]]:
    """A unit's parameters as effects of the catalogue, which has the common gain nowhere."""
    problem = solution.fit.problem
    common = float(solution.fit.parameters[problem.unit_at(unit)][NAMES.index("common_gain")])
    return effects_of_values(parameters_of(solution, unit), 1.0 + common, problem.linear)


def map_document(solution: Solution, rig: str | None = None) -> dict[str, Any]:
    """The stage's map."""
    separable = all(solution.is_separable(unit) for unit in range(len(solution.table.units)))
    return stage_map(solution, separable, rig)
