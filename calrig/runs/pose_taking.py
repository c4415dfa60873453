"""How a run takes a pose: it settles, dwells, and makes a pose of the dwell, kept with its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from calrig.analysis.errors import NotTheSame
from calrig.calibration.move_check import MoveCheck
from calrig.calibration.poses import GYRO_MEANS, MOUNT_DEG, Filtering, Pose
from calrig.estimation.angles import AXES
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.reading import Reading, dwell_reading
from calrig.instruments.errors import BoardError
from calrig.instruments.types import FloatArray, Samples
from calrig.plan import Plan, PlannedPose
from calrig.runs.felt_moves import KIND, FeltMoves, lost, told
from calrig.runs.own_gyro import OwnGyro
from calrig.runs.pace import Pace
from calrig.runs.resume import MOVE_OFF_DEG, Returned, way_back
from calrig.runs.stopping_rule import StoppingRule
from calrig.runs.stream import Phase, block_of
from calrig.runs.task import Earlier
from calrig.store.records import filtering_of

FEWEST_FOR_TARGET_S = 0.5
"""A dwell with `target_std_deg` is at least this long: a standard error from less is itself a guess."""
DWELL_TRIES = 3
MOVED_DEG = 1e-4
"""A change of reported angle below this is no move."""


@dataclass
class PoseTaking:
    """The poses of a run so far, and what carries over from one to the next.

    `felt` is what the unit felt of the moves between them. `stopping_rule` tells where the plan need not be
    carried out whole, `is_enough` whether that is so by now. `returned` is what the last pose before an
    interruption gave when it was measured once more.
    """

    plan: Plan
    pace: Pace
    earlier: Earlier = field(default_factory=Earlier)
    stopping_rule: StoppingRule | None = None
    returned: Returned | None = None
    is_enough: bool = field(init=False)
    gyro: OwnGyro = field(init=False)
    felt: FeltMoves = field(init=False)
    poses: list[Pose] = field(init=False)
    noise: KalmanNoise = field(init=False)
    filtering: Filtering | None = field(init=False)
    approach: int = 0

    def __post_init__(self) -> None:
        self.rig, self.recorder = self.pace.rig, self.pace.recorder
        self.poses = list(self.earlier.poses)
        self.gyro = OwnGyro(AXES.index(self.plan.mount_axis[-1]), list(self.earlier.biases))
        self.felt = FeltMoves(self.poses, self.rig.board_identity.gyro_range_dps, self.plan.mount_axis)
        self.noise = KalmanNoise(**self.rig.settings.filter.model_dump())
        self.filtering = filtering_of(self.rig.provenance(), self.plan.model_dump())
        self.is_enough = self._reached()  # by a run that was interrupted before it could say so

    def return_to_last(self) -> None:
        """Goes back to the last pose before an interruption, and measures it once more.

        So the next move begins where it would have begun, on the same side of the backlash. Whether the unit
        still reads there what it read tells whether anything was touched meanwhile.
        """
        last = self.poses[-1]
        for elevation_deg in way_back(last, self.rig.axis.limits_deg):
            before_deg = self.pace.stage_deg
            self.pace.move(elevation_deg)
            self.note_approach(before_deg)
        name = f"pose {len(self.poses) - 1}, measured again"
        _, end_s, reading = self.measure(name, last.target_deg, self.plan.settle_s)
        returned = Returned(last, reading)
        try:
            returned.require_same_unit()
        except NotTheSame as why:
            raise self.rig.place.doubted(why) from why
        self.returned = returned
        self.pace.forget(end_s)

    def move_off(self, planned: list[PlannedPose]) -> None:
        """Leaves the first elevation where the stage stands on it: how it came there is not known.

        Which side of the backlash the table lies on, and whether it has settled, is for calibration to say.
        """
        first_deg, stands_deg = planned[0].target_deg, self.pace.stage_deg
        stays = stands_deg is not None and abs(first_deg - stands_deg) <= self.rig.axis.tolerance_deg
        away_deg = max((pose.target_deg - first_deg for pose in planned), key=abs)
        if stays and away_deg:
            self.pace.move(first_deg + math.copysign(min(MOVE_OFF_DEG, abs(away_deg)), away_deg))
            self.pace.stood_at_s = self.pace.synchronise()

    def take(self, planned: PlannedPose, settle_s: float | None = None) -> None:
        """One pose, its dwell repeated where too few valid samples came; `settle_s` else as in the plan."""
        settle_s = self.plan.settle_s if settle_s is None else settle_s
        before_deg = self.pace.stage_deg
        self.pace.move(planned.target_deg)
        self.note_approach(before_deg)
        measured = self.measure(f"pose {planned.index}", planned.target_deg, settle_s)
        self.keep_dwell(planned, before_deg, settle_s, *measured)

    def measure(self, name: str, target_deg: float, settle_s: float) -> tuple[float, float, Reading]:
        """Settles and dwells; begin and end of the dwell, and its reading."""
        for _ in range(DWELL_TRIES):
            start_s = self.pace.synchronise() + settle_s
            self.pace.wait_until(start_s)
            end_s, reading = self._dwell(start_s)
            if reading is not None:
                return start_s, end_s, reading
            self.rig.board.faults["retried_pose"] += 1
        raise BoardError(
            f"{name} at {target_deg:g}°: fewer than half of the samples of the dwell "
            f"were valid, {DWELL_TRIES} times over; check the cable and the board's rate"
        )

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
            self.noise,
        )

    def note_approach(self, before_deg: float | None) -> None:
        """Takes down in which sense the stage has turned, if it has."""
        if before_deg is None or self.pace.stage_deg is None:
            return
        turned_deg = self.pace.stage_deg - before_deg
        if abs(turned_deg) > MOVED_DEG:
            self.approach = 1 if turned_deg > 0 else -1

    def keep_dwell(
        self,
        planned: PlannedPose,
        before_deg: float | None,
        settle_s: float,
        start_s: float,
        end_s: float,
        reading: Reading,
    ) -> None:
        """Makes a pose of a dwell, stores it with its samples, and lets go of them.

        `before_deg` is what the stage reported before the move into it, `settle_s` how long it settled.
        """
        self.pace.see_that_it_stands()
        stretch = self.pace.stream.kept()
        before = stretch.between(-np.inf, start_s).samples
        move = before.between(self.pace.stood_at_s, start_s)
        dwell = stretch.between(start_s, end_s)
        bias_std_dps = self.gyro.dwelt(dwell.samples)
        turned_deg = (
            None if before_deg is None or self.pace.stage_deg is None else self.pace.stage_deg - before_deg
        )
        times_s = 1.0 / self.pace.rate_hz, self.rig.axis.travel_s(turned_deg or 0.0)
        taken = pose_of(planned, dwell.samples, reading)
        of_mounts: dict[str, float | None] = {}
        if self.plan.asks_for_mounts:
            of_mounts = {MOUNT_DEG: planned.mount_deg, **self.gyro.felt_about_axes_deg(move, *times_s)}
        pose = replace(
            taken,
            approach=self.approach,
            time_s=(start_s + end_s) / 2,
            stage_deg=self.pace.stage_deg,
            gyro_move_deg=self.gyro.felt_deg(move, *times_s),
            settle_s=settle_s,
            covariates={**taken.covariates, **of_mounts},
            filtering=self.filtering,
        )
        check = self.felt.take(pose, turned_deg, move, bias_std_dps, end_s - start_s)
        self.keep(pose, before, dwell.samples, check)
        self.pace.forget(end_s)

    def keep(self, pose: Pose, before: Samples, taken: Samples, check: MoveCheck | None) -> None:
        """Stores a pose, and says where the unit felt another move; StageError where that ends the run.

        `before` are the samples since the pose before, `taken` its own. A stretch is never a run's last pose.
        """
        index = len(self.poses)  # of the poses measured: a follow-up skips some that were planned
        self.poses.append(pose)
        self.is_enough = pose.settle_s is not None and self._reached()
        if self.is_enough:
            self.recorder.is_the_last()
        also = []
        if check is not None and check.verdict != "agrees":
            self.rig.board.faults[KIND] += 1
            also.append(told(index, pose, check))
        both: list[tuple[Phase, Samples]] = [("move", before), ("dwell", taken)]
        blocks = [block_of(index, phase, samples) for phase, samples in both if len(samples)]
        self.recorder.pose(index, pose, blocks, self.rig.faults(), *also)
        if check is not None and check.verdict == "lost":
            self.rig.place.is_lost()
            raise lost(index, pose, check)

    def _reached(self) -> bool:
        return self.stopping_rule is not None and self.stopping_rule.reached(self.poses)


def pose_of(planned: PlannedPose, samples: Samples, reading: Reading) -> Pose:
    """What samples and reading alone say of a pose."""
    return Pose(
        target_deg=planned.target_deg,
        reading_deg=reading.reading_deg,
        sweep=planned.sweep,
        temperature_c=_mean(samples.temperature_c),
        reading_std_deg=reading.reading_std_deg,
        reading_stderr_deg=reading.reading_stderr_deg,
        n_samples=len(samples),
        accel_x_g=_mean(samples.accel_g[:, 0]),
        accel_y_g=_mean(samples.accel_g[:, 1]),
        accel_z_g=_mean(samples.accel_g[:, 2]),
        covariates={
            name: mean
            for name, rate_dps in zip(GYRO_MEANS, samples.gyro_dps.T, strict=True)
            if (mean := _mean(rate_dps)) is not None
        },
    )


def _mean(values: FloatArray) -> float | None:
    """The mean, or None where the board does not send the channel."""
    mean = float(np.mean(values))
    return None if np.isnan(mean) else mean
