"""About what each pose of a sweep takes: by the plan, for the time that is left of its run."""

from __future__ import annotations

from collections.abc import Sequence

from calrig.plan import Plan, PlannedPose


def planned_times_s(plan: Plan, planned: Sequence[PlannedPose], stored: int, first_s: float) -> list[float]:
    """Times of the poses, s; those of a pass are told together at its end, its first one for all of them.

    Args:
        plan: of kind `sweep`.
        planned: its poses.
        stored: how many of them an interrupted run has stored; a pass that is turned anew counts from there.
        first_s: of the move to the first one.
    """
    times_s = [0.0] * len(planned)
    times_s[0] = plan.wait_s + first_s + plan.first_settle_s + plan.dwell_s
    begins, from_deg = 1, planned[0].target_deg
    for pose in planned[1:]:
        if pose.stretch_deg is not None:
            continue
        turn_s = abs(pose.target_deg - from_deg) / plan.turn_dps
        if stored <= pose.index:
            waits_s = plan.wait_s if pose.sweep else 0.0
            times_s[max(begins, stored)] = waits_s + turn_s + plan.settle_s + plan.dwell_s
        begins, from_deg = pose.index + 1, pose.target_deg
    return times_s
