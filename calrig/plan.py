"""The plan of a run, for programs that write one; it is defined in `calrig.model.plan`."""

from calrig.model.plan import MAX_POSES, Plan, PlanError, PlannedPose, Until

__all__ = ["MAX_POSES", "Plan", "PlanError", "PlannedPose", "Until"]
