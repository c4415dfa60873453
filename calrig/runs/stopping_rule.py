"""Sequential stopping of a run by `until` (CONTRACT section 9), limited by the reference uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.analysis.errors import Invalid
from calrig.analysis.results import fitted
from calrig.calibration.plan_design import Goals, TypeB
from calrig.calibration.poses import Pose
from calrig.calibration.results import FittedResult
from calrig.calibration.separation import StageMap, map_reference, with_map
from calrig.calibration.uncertainty import Ending, has_the_line, turned_both_ways
from calrig.model.plan import Plan, PlannedPose, Until
from calrig.model.result import Reference
from calrig.settings import RigSettings
from calrig.store import AcceptedEffect, Store
from calrig.store.records import Document, map_of

REACHED = Ending(may_be_early=True, stopped_by="until")


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """What a run is to reach, and what its result follows from beside its poses.

    Attributes:
        until: of its plan.
        planned: every pose of the plan.
        accepted: effects in force for the unit and its rig; a bench of a centre knows of none.
        provenance: of the run.
    """

    until: Until
    planned: Sequence[PlannedPose]
    accepted: Sequence[AcceptedEffect]
    provenance: Document

    def reached(self, poses: Sequence[Pose]) -> bool:
        """Whether the result that the run would have, should it end now, is good enough."""
        stage_map = map_of(self.provenance)
        poses = poses if stage_map is None else with_map(poses, stage_map)
        visited_deg = [pose.target_deg for pose in poses]
        planned_deg = [pose.target_deg for pose in self.planned]
        if not (has_the_line(visited_deg, planned_deg) and turned_both_ways(poses)):
            return False
        return holds(self.until, fitted(poses, self.accepted, self.provenance, ending=REACHED))


def holds(until: Until, result: FittedResult) -> bool:
    """Whether a result states what is wanted; its expanded uncertainty is that of the unit's calibration."""
    expanded_deg = None if result.over_range is None else result.over_range.expanded_uncertainty_deg
    return goals_of(until).reached_by(expanded_deg, result.bias_std_deg, result.scale_std)


def goals_of(until: Until) -> Goals:
    """The same, as plans are designed for it."""
    return Goals(until.expanded_uncertainty_deg, until.bias_std_deg, until.scale_std)


PLACE = "plan.until.expanded_uncertainty_deg"


def reference_uncertainty(
    rig: RigSettings,
    unit: str,
    elevations_deg: Sequence[float],
    store: Store | None,
    in_force: Document | None,
) -> TypeB | None:
    """What the reference makes of a calibrated elevation; None where it is not known.

    Args:
        rig: says what its stage's angle is worth.
        unit: whose accepted effects are taken out beside bias and scale.
        elevations_deg: of a sweep of the plan.
        store: has the effects; None where there is none yet.
        in_force: what the run keeps of the stage's map, as of `stage_maps.kept_of`; None without one.
    """
    if in_force is not None:
        theta_deg = np.array(elevations_deg, dtype=np.float64)
        accepted = () if store is None else store.effects.in_force(unit, rig.name)
        bent = any(effect.unit is not None for effect in accepted)
        middle = np.zeros(len(theta_deg))  # of the play: from which side each is come to is not known yet
        found = map_reference(StageMap.from_frozen(in_force), theta_deg, theta_deg, middle, bent=bent)
        return TypeB(found.std_deg, None)
    stated = rig.reference
    if stated is None or stated.std_deg is None:
        return None
    return TypeB(stated.std_deg, Reference(stated.std_deg, stated.kind, stated.distribution))


def require_reachable(
    plan: Plan, rig: RigSettings, unit: str, store: Store, in_force: Document | None
) -> None:
    """Raises Invalid where no run of a plan could end by its `until`: the reference is not worth so much.

    Arguments as of `reference_worth`.
    """
    if plan.until is None or plan.until.expanded_uncertainty_deg is None:
        return
    if in_force is None and rig.reference is None:
        raise Invalid(
            f"rig {rig.name!r} has no `reference`, so its expanded uncertainty is unknown and cannot end a "
            "run: add `reference` to the rig, or remove this goal",
            [PLACE],
        )
    if in_force is None and rig.reference is not None and rig.reference.map is not None:
        return  # a centre does not know the map that a file of its bench gives
    worth = reference_uncertainty(rig, unit, plan.elevations(), store, in_force)
    below = None if worth is None else worth.why_beyond(goals_of(plan.until))
    if below is not None:
        raise Invalid(below, [PLACE])
