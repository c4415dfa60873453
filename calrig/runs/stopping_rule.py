"""Sequential stopping of a run: CONTRACT section 9's `until`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calrig.analysis.results import fitted
from calrig.calibration.plan_design import Goals
from calrig.calibration.poses import Pose
from calrig.calibration.results import Result
from calrig.calibration.separation import with_map
from calrig.calibration.uncertainty import Ending, has_the_line, turned_both_ways
from calrig.plan import PlannedPose, Until
from calrig.store import AcceptedEffect
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


def holds(until: Until, result: Result) -> bool:
    """Whether a result states what is wanted; its expanded uncertainty is that of the unit's calibration."""
    expanded_deg = None if result.over_range is None else result.over_range.expanded_uncertainty_deg
    return goals_of(until).reached_by(expanded_deg, result.bias_std_deg, result.scale_std)


def goals_of(until: Until) -> Goals:
    """The same, as plans are designed for it."""
    return Goals(until.expanded_uncertainty_deg, until.bias_std_deg, until.scale_std)
