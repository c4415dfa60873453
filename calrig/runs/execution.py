"""One run on an open rig: home, then for each pose move, settle, dwell, and from the dwell a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from calrig.calibration.move_check import MoveCheck
from calrig.calibration.pose import MOUNT_DEG, Filtering, Pose
from calrig.estimation.angles import AXES
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.reading import Reading, dwell_reading
from calrig.instruments.errors import BoardError
from calrig.instruments.types import FloatArray
from calrig.plan import Plan, PlannedPose
from calrig.runs.felt_moves import KIND, FeltMoves, lost, told
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.mounting import Mount, OwnErrors
from calrig.runs.own_gyro import OwnGyro
from calrig.runs.pace import Pace
from calrig.runs.resume import MOVE_OFF_DEG, Returned, way_back
from calrig.runs.stream import block_of
from calrig.runs.sweep_waits import wait_before_sweep
from calrig.runs.task import Earlier
from calrig.store import SampleBlock

FEWEST_FOR_TARGET_S = 0.5
"""A dwell with `target_std_deg` is at least this long: a standard error from less is itself a guess."""
DWELL_TRIES = 3
MOVED_DEG = 1e-4
"""A change of reported angle below this is no move."""


@dataclass
class Execution:
    """What a run carries from pose to pose. `felt` is what the unit felt of the moves between them.

    `returned` is what the last pose before an interruption gave when it was measured once more.
    """

    plan: Plan
    pace: Pace
    follow_up: FollowUpRun | None = None
    earlier: Earlier = field(default_factory=Earlier)
    returned: Returned | None = None
    gyro: OwnGyro = field(init=False)
    felt: FeltMoves = field(init=False)
    poses: list[Pose] = field(init=False)
    _approach: int = 0

    def __post_init__(self) -> None:
        self.rig, self.recorder = self.pace.rig, self.pace.recorder
        self.poses = list(self.earlier.poses)
        self.gyro = OwnGyro(AXES.index(self.plan.mount_axis[-1]), list(self.earlier.biases))
        self.felt = FeltMoves(self.poses, self.rig.board_identity.gyro_range_dps, self.plan.mount_axis)
        self._noise = KalmanNoise(**self.rig.settings.filter.model_dump())

    def carry_out(self, planned: list[PlannedPose]) -> None:
        """Homes the stage where it must be, then takes the planned poses that are left, in their order.

        Raises:
            Ended: the run was asked to end.
            InstrumentError: a device failed; the poses so far are stored.
            NotTheSame: after an interruption the last pose reads otherwise by far.
        """
        left = self._left(planned)
        sweep: int | None = None
        clamped_deg = self._begin(left)
        if self.poses and clamped_deg is not None:
            self._return(self.poses[-1])
            sweep = self.poses[-1].sweep
        elif clamped_deg is not None:
            self._move_off(planned)
        self.recorder.poses_begin()
        for pose in left:
            if pose.mount_deg != clamped_deg:
                clamped_deg = pose.mount_deg
                self._have_turned(self._mount(clamped_deg), left)
            if self.follow_up is not None and self.follow_up.skips(pose, self.poses):
                self.recorder.skip_pose()
                continue
            if pose.sweep != sweep:
                sweep = pose.sweep
                wait_before_sweep(self.plan, self.pace)
            self._take(pose)
            self.pace.hold_while_paused()

    def _begin(self, left: list[PlannedPose]) -> float | None:
        """Makes stage and board ready; the mount that the unit sits at, None where a person is to be asked.

        Nobody is asked for a first mount that gravity agrees with. A run that was interrupted between two
        mounts goes on waiting: somebody may have turned the unit half-way.
        """
        if self.poses:
            last_deg = self.poses[-1].mount_deg
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

    def _mount(self, mount_deg: float) -> Mount:
        return Mount(mount_deg, self.plan.mount_axis)

    def _have_turned(self, mount: Mount, left: list[PlannedPose]) -> None:
        """Has a person clamp the unit anew, while the stage stands where it is.

        Gravity tells the angle about the stage's axis at any angle of the dial. Hands may have pushed the
        table through its play meanwhile.
        """
        self.pace.wait_for_mount(mount, OwnErrors(self.poses, mount.sense))
        self.felt.touched()
        self._move_off([pose for pose in left if pose.mount_deg == mount.deg])

    def _left(self, planned: list[PlannedPose]) -> list[PlannedPose]:
        """The poses not measured yet; a follow-up decides once more what it has decided before."""
        known = 0
        for place, pose in enumerate(planned):
            if known == len(self.poses):
                return planned[place:]
            if self.follow_up is not None and self.follow_up.skips(pose, self.poses[:known]):
                self.recorder.skip_pose()
            else:
                known += 1
        return []

    def _return(self, last: Pose) -> None:
        """Goes back to the last pose before an interruption, and measures it once more.

        So the next move begins where it would have begun, on the same side of the backlash. Whether the unit
        still reads there what it read tells whether anything was touched meanwhile.
        """
        for elevation_deg in way_back(last, self.rig.axis.limits_deg):
            before_deg = self.pace.stage_deg
            self.pace.move(elevation_deg)
            self._note_approach(before_deg)
        _, end_s, reading = self._measure(f"pose {len(self.poses) - 1}, measured again", last.target_deg)
        returned = Returned(last, reading)
        returned.require_same_unit()
        self.returned = returned
        self.pace.forget(end_s)

    def _move_off(self, planned: list[PlannedPose]) -> None:
        """Leaves the first elevation where the stage stands on it: how it came there is not known.

        Which side of the backlash the table lies on, and whether it has settled, is for calibration to say.
        """
        first_deg, stands_deg = planned[0].target_deg, self.pace.stage_deg
        stays = stands_deg is not None and abs(first_deg - stands_deg) <= self.rig.axis.tolerance_deg
        away_deg = max((pose.target_deg - first_deg for pose in planned), key=abs)
        if stays and away_deg:
            self.pace.move(first_deg + math.copysign(min(MOVE_OFF_DEG, abs(away_deg)), away_deg))
            self.pace.stood_at_s = self.pace.synchronise()

    def _take(self, planned: PlannedPose) -> None:
        """One pose, its dwell repeated where too few valid samples came."""
        before_deg = self.pace.stage_deg
        self.pace.move(planned.target_deg)
        self._note_approach(before_deg)
        start_s, end_s, reading = self._measure(f"pose {planned.index}", planned.target_deg)
        self._finish(planned, before_deg, start_s, end_s, reading)

    def _measure(self, name: str, target_deg: float) -> tuple[float, float, Reading]:
        """Settles and dwells; begin and end of the dwell, and its reading."""
        for _ in range(DWELL_TRIES):
            start_s = self._settle()
            end_s, reading = self._dwell(start_s)
            if reading is not None:
                return start_s, end_s, reading
            self.rig.board.faults["retried_pose"] += 1
        raise BoardError(
            f"{name} at {target_deg:g}°: fewer than half of the samples of the dwell "
            f"were valid, {DWELL_TRIES} times over; check the cable and the board's rate"
        )

    def _settle(self) -> float:
        start_s = self.pace.synchronise() + self.plan.settle_s
        self.pace.wait_until(start_s)
        return start_s

    def _dwell(self, start_s: float) -> tuple[float, Reading | None]:
        """Dwells from start_s; returns when it ended and its reading, or None where samples are missing."""
        end_s = start_s + self.plan.dwell_s
        if self.plan.target_std_deg is not None:
            self.pace.wait_until(min(start_s + FEWEST_FOR_TARGET_S, end_s))
            while self.pace.stream.clock_s < end_s:
                reading = self._reading(start_s, self.pace.stream.clock_s)
                error_deg = None if reading is None else reading.reading_stderr_deg
                if error_deg is not None and error_deg <= self.plan.target_std_deg:
                    end_s = self.pace.stream.clock_s
                    break
                self.pace.look()
        self.pace.wait_until(end_s)
        return end_s, self._reading(start_s, end_s)

    def _reading(self, start_s: float, end_s: float) -> Reading | None:
        dwell = self.pace.stream.kept().between(start_s, end_s)
        if len(dwell.samples) < max(2, 0.5 * (end_s - start_s) * self.pace.rate_hz):
            return None
        rate_dps = dwell.samples.gyro_dps[:, self.gyro.along]
        return dwell_reading(
            dwell.samples.time_s,
            dwell.elevation_deg,
            None if np.isnan(rate_dps).any() else rate_dps,
            dwell.filtered_deg,
            self._noise,
        )

    def _note_approach(self, before_deg: float | None) -> None:
        if before_deg is None or self.pace.stage_deg is None:
            return
        turned_deg = self.pace.stage_deg - before_deg
        if abs(turned_deg) > MOVED_DEG:
            self._approach = 1 if turned_deg > 0 else -1

    def _finish(
        self, planned: PlannedPose, before_deg: float | None, start_s: float, end_s: float, reading: Reading
    ) -> None:
        """Makes a pose of a dwell, stores it with its samples, and lets go of them."""
        self.pace.see_that_it_stands()
        stretch = self.pace.stream.kept()
        before = stretch.between(-np.inf, start_s).samples
        move = before.between(self.pace.stood_at_s, start_s)
        dwell = stretch.between(start_s, end_s).samples
        bias_std_dps = self.gyro.dwelt(dwell)
        turned_deg = (
            None if before_deg is None or self.pace.stage_deg is None else self.pace.stage_deg - before_deg
        )
        times_s = 1.0 / self.pace.rate_hz, self.rig.axis.travel_s(turned_deg or 0.0)
        of_mounts: dict[str, float | None] = {}
        if self.plan.asks_for_mounts:
            of_mounts = {MOUNT_DEG: planned.mount_deg, **self.gyro.of_all_axes(dwell, move, *times_s)}
        pose = Pose(
            target_deg=planned.target_deg,
            reading_deg=reading.reading_deg,
            sweep=planned.sweep,
            approach=self._approach,
            time_s=(start_s + end_s) / 2,
            temperature_c=_mean(dwell.temperature_c),
            stage_deg=self.pace.stage_deg,
            reading_std_deg=reading.reading_std_deg,
            reading_stderr_deg=reading.reading_stderr_deg,
            n_samples=len(dwell),
            accel_x_g=_mean(dwell.accel_g[:, 0]),
            accel_y_g=_mean(dwell.accel_g[:, 1]),
            accel_z_g=_mean(dwell.accel_g[:, 2]),
            gyro_move_deg=self.gyro.felt_deg(move, *times_s),
            settle_s=self.plan.settle_s,
            covariates=of_mounts,
            filtering=Filtering(self._noise, self.pace.rate_hz, self.plan.dwell_s),
        )
        blocks = [block_of(len(self.poses), "move", before), block_of(len(self.poses), "dwell", dwell)]
        check = self.felt.take(pose, turned_deg, move, bias_std_dps, end_s - start_s)
        self._conclude(pose, blocks, check)
        self.pace.forget(end_s)

    def _conclude(self, pose: Pose, blocks: list[SampleBlock], check: MoveCheck | None) -> None:
        """Stores a pose, and says where the unit felt another move; StageError where that ends the run."""
        index = len(self.poses)  # of the poses measured: a follow-up skips some that were planned
        self.poses.append(pose)
        also = []
        if check is not None and check.verdict != "agrees":
            self.rig.board.faults[KIND] += 1
            also.append(told(index, pose, check))
        self.recorder.pose(index, pose, blocks, self.rig.faults(), *also)
        if check is not None and check.verdict == "lost":
            self.rig.place.is_lost()
            raise lost(index, pose, check)


def _mean(values: FloatArray) -> float | None:
    """The mean, or None where the board does not send the channel."""
    mean = float(np.mean(values))
    return None if np.isnan(mean) else mean
