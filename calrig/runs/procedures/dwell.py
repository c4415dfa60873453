"""Dwell procedure: home, then move, settle and dwell for each pose; a pose is one dwell."""

from dataclasses import dataclass

from calrig.model.plan import Plan, PlannedPose
from calrig.runs.acquisition import AcquisitionLoop
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.mounting import Mounting, OwnErrors
from calrig.runs.pose_acquisition import PoseAcquisition, wait_before_sweep


@dataclass
class DwellSequence:
    """A plan of dwells and the poses that it takes; of a run that follows others, when it skips some."""

    plan: Plan
    pace: AcquisitionLoop
    taking: PoseAcquisition
    follow_up: FollowUpRun | None = None

    def carry_out(self, planned: list[PlannedPose]) -> None:
        """Homes the stage where it must be, then takes the planned poses that are left, in their order.

        Raises:
            Ended: the run was asked to end.
            InstrumentError: a device failed; the poses so far are stored.
            NotTheSame: after an interruption the last pose reads otherwise by far.
        """
        taking = self.taking
        left = [] if taking.is_enough else self._left(planned)
        sweep: int | None = None
        clamped_deg = self._begin(left)
        if taking.poses and clamped_deg is not None:
            taking.return_to_last()
            sweep = taking.poses[-1].sweep
        elif clamped_deg is not None:
            taking.move_off(planned)
        self.pace.recorder.poses_begin()
        for pose in left:
            if pose.mount_deg != clamped_deg:
                clamped_deg = pose.mount_deg
                self._have_turned(self._mount(clamped_deg), left)
            if self.follow_up is not None and self.follow_up.skips(pose, taking.poses):
                self.pace.recorder.skip_pose()
                continue
            if pose.sweep != sweep:
                sweep = pose.sweep
                wait_before_sweep(self.plan, self.pace)
            taking.take(pose)
            if taking.is_enough:
                return
            self.pace.hold_while_paused()

    def _begin(self, left: list[PlannedPose]) -> float | None:
        """Makes stage and board ready; the mount that the unit sits at, None where a person is to be asked.

        Nobody is asked for a first mount that gravity agrees with. A run that was interrupted between two
        mounts goes on waiting: somebody may have turned the unit half-way.
        """
        if self.taking.poses:
            last_deg = self.taking.poses[-1].mount_deg
            clamped_deg = None if left and left[0].mount_deg != last_deg else last_deg
            mount = None if clamped_deg is None else self._mount(clamped_deg)
            self.pace.begin(self.plan, moves=True, mount=mount)
            return clamped_deg
        mount = self._mount(left[0].mount_deg)
        if not self.plan.asks_for_mounts:
            self.pace.begin(self.plan, moves=True, mount=mount)
            return mount.deg
        self.pace.begin(self.plan, moves=True)
        return mount.deg if self.pace.why_not(mount, OwnErrors()) is None else None

    def _mount(self, mount_deg: float) -> Mounting:
        return Mounting(mount_deg, self.plan.mount_axis)

    def _have_turned(self, mount: Mounting, left: list[PlannedPose]) -> None:
        """Has a person clamp the unit anew, while the stage stands where it is.

        Gravity tells the angle about the stage's axis at any angle of the dial. Hands may have pushed the
        table through its play meanwhile.
        """
        self.pace.wait_for_mount(mount, OwnErrors(self.taking.poses, mount.sense))
        self.taking.felt.touched()
        self.taking.move_off([pose for pose in left if pose.mount_deg == mount.deg])

    def _left(self, planned: list[PlannedPose]) -> list[PlannedPose]:
        """The poses not measured yet; a follow-up decides once more what it has decided before."""
        known = 0
        for place, pose in enumerate(planned):
            if known == len(self.taking.poses):
                return planned[place:]
            if self.follow_up is not None and self.follow_up.skips(pose, self.taking.poses[:known]):
                self.pace.recorder.skip_pose()
            else:
                known += 1
        return []
