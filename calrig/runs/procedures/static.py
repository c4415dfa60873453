"""Static procedure: the stage is at rest, and the whole log is stored for noise analysis."""

from calrig.model.plan import Plan, PlannedPose
from calrig.runs.acquisition import AcquisitionLoop, block_of
from calrig.runs.mounting import Mounting

BLOCK_S = 10.0
"""So much of a log is lost at most where the process dies."""


def keep_log(plan: Plan, planned: list[PlannedPose], pace: AcquisitionLoop, logged_s: float = 0.0) -> None:
    """Keeps what the board sends for `dwell_s`; nothing moves unless the plan names an elevation.

    A pause or an interruption leaves a gap in the log.

    `planned` is the elevation to stand at, empty where it stands already; `logged_s` how much was kept before
    an interruption.

    Raises:
        Ended: the run was asked to end; the log so far is stored.
        InstrumentError: a device failed; likewise.
    """
    mount = Mounting(plan.mounts_deg[0], plan.mount_axis)
    pace.begin(plan, moves=bool(planned), mount=mount)
    for pose in planned:
        pace.move(pose.target_deg)
    between_samples_s = 0.5 / pace.rate_hz  # so that no rounding decides to which block one belongs
    settled_s = pace.synchronise() + plan.settle_s + between_samples_s
    pace.wait_until(settled_s)
    pace.forget(settled_s)
    left_s = plan.dwell_s - logged_s  # counted down by whole blocks, so that rounding leaves no sliver of one
    while left_s > 0.0:
        length_s = min(BLOCK_S, left_s)
        end_s = pace.stood_at_s + length_s
        pace.wait_until(end_s)
        left_s -= length_s
        block = block_of(0, "dwell", pace.stream.kept().between(pace.stood_at_s, end_s).samples)
        pace.recorder.log(block, plan.dwell_s - left_s, left_s, pace.rig.faults())
        pace.forget(end_s)
        if pace.control.holding:
            pace.hold_while_paused()
            pace.forget(pace.synchronise())
