"""Acquire a pose: settle, dwell, make a pose of the samples, compare the move with gyro and stage."""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from calrig.analysis.errors import NotTheSame
from calrig.calibration.move_check import MoveCheck, MoveWatch, gyro_move_std_deg
from calrig.calibration.poses import GYRO_MEANS, GYRO_MOVES, MOUNT_DEG, Filtering, Pose
from calrig.calibration.results import UNKNOWN_GYRO
from calrig.estimation.angles import AXES, along_axis
from calrig.estimation.gyro import GyroBias, dwell_bias, felt_move_deg, gyro_scale, run_bias
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.reading import Reading, dwell_reading
from calrig.instruments.errors import BoardError, StageError
from calrig.instruments.types import FloatArray, Samples
from calrig.model.plan import Plan, PlannedPose
from calrig.model.result import Gyro
from calrig.runs.acquisition import AcquisitionLoop, Phase, block_of
from calrig.runs.assignment import Earlier
from calrig.runs.plan_estimates import StoppingRule
from calrig.runs.resume import MOVE_OFF_DEG, Returned, way_back
from calrig.store.records import filtering_of

KIND = "move_mismatch"
"""Of a run's faults, and of the event that tells of one."""
REPLAYED_STD_DEG = 0.05
"""Of the gyro over a move whose samples were let go of."""
FULL_SCALE = 0.98
"""A rate nearer to the end of the gyro's range may have been cut off."""


class MoveMonitor:
    """What the unit has felt of a run's moves: `turned_deg` by the stage, `felt_deg` by the gyro, in pairs.

    `axis` is which of the unit's lies along the stage's; reversed, the unit turns against it.
    """

    def __init__(self, poses: list[Pose], gyro_range_dps: int | None, axis: str = "x") -> None:
        self.turned_deg, self.felt_deg = array("d"), array("d")
        self._range_dps = gyro_range_dps
        self._watch = MoveWatch()
        self._axis, self._sense = axis, -1 if axis.startswith("-") else 1
        last_deg: float | None = None
        clamped_deg: float | None = None
        for pose in poses:
            if clamped_deg is not None and pose.mount_deg != clamped_deg:
                self.touched()
            turned_deg = None if last_deg is None or pose.stage_deg is None else pose.stage_deg - last_deg
            self._note(pose, turned_deg, self._judged(pose, turned_deg, REPLAYED_STD_DEG))
            last_deg, clamped_deg = pose.stage_deg, pose.mount_deg
        self.touched()  # nobody saw what happened before the run went on

    def touched(self) -> None:
        """Somebody had the unit in hand: its elevation at the last pose is not that before the next move."""
        self._watch.touched()

    def take(
        self, now: Pose, turned_deg: float | None, move: Samples, bias_std_dps: float | None, dwell_s: float
    ) -> MoveCheck | None:
        """Judges the move into a pose by its samples; None where nothing tells of it."""
        rate_dps = along_axis(move.gyro_dps, self._axis)[:, 0]
        felt = now
        if self._range_dps is not None and np.abs(rate_dps).max(initial=0.0) > FULL_SCALE * self._range_dps:
            felt = replace(now, gyro_move_deg=None)
        std_deg = gyro_move_std_deg(move.time_s, rate_dps, bias_std_dps, dwell_s)
        check = self._judged(felt, turned_deg, std_deg if felt.gyro_move_deg is not None else 0.0)
        self._note(felt, turned_deg, check)
        return check

    def _judged(self, pose: Pose, turned_deg: float | None, gyro_std_deg: float) -> MoveCheck | None:
        """Holds a move against what the unit felt about the axis that lies along the stage's."""
        if self._axis != "x":
            pose = self._as_about_x(pose)
        turned_deg = None if turned_deg is None else self._sense * turned_deg
        check = self._watch.take(pose, turned_deg, gyro_std_deg)
        if check is None or self._sense > 0:
            return check
        return replace(
            check,
            stage_deg=-check.stage_deg,
            felt_deg=-check.felt_deg,
            gyro_deg=None if check.gyro_deg is None else -check.gyro_deg,
            gravity_deg=None if check.gravity_deg is None else -check.gravity_deg,
        )

    def _as_about_x(self, pose: Pose) -> Pose:
        """The pose of a unit that turned about its x, in the sense in which it turns."""
        vector = np.array([[pose.accel_x_g, pose.accel_y_g, pose.accel_z_g]], dtype=np.float64)
        x, y, z = along_axis(vector, self._axis)[0].tolist()
        stage_deg = None if pose.stage_deg is None else self._sense * pose.stage_deg
        return replace(pose, accel_x_g=x, accel_y_g=y, accel_z_g=z, stage_deg=stage_deg)

    def _note(self, now: Pose, turned_deg: float | None, check: MoveCheck | None) -> None:
        """A move that was not what the stage says is none to learn the gyro's scale from."""
        if now.gyro_move_deg is not None and turned_deg is not None and check and check.verdict == "agrees":
            self.turned_deg.append(self._sense * turned_deg)
            self.felt_deg.append(now.gyro_move_deg)


def told(index: int, pose: Pose, check: MoveCheck) -> tuple[str, dict[str, Any]]:
    """The event of a move that was felt otherwise."""
    data = {
        "index": index,
        "target_deg": pose.target_deg,
        "stage_move_deg": check.stage_deg,
        "felt_move_deg": check.felt_deg,
        "difference_deg": check.difference_deg,
        "std_deg": check.std_deg,
        "gyro_deg": check.gyro_deg,
        "gravity_deg": check.gravity_deg,
        "ends_run": check.verdict == "lost",
        "says": f"Pose {index} at {pose.target_deg:g}°: {check.words()}.",
    }
    return KIND, data


def lost(index: int, pose: Pose, check: MoveCheck) -> StageError:
    """The end of a run whose stage is not where it says."""
    return StageError(
        f"pose {index} at {pose.target_deg:g}°: {check.words()}. The stage lost steps or slips, or "
        "the unit came loose or is clamped the other way round, or ratio or sign of the rig is wrong: free "
        "the stage, see that the unit sits tight and as the plan says, home the stage (without homing: turn "
        'it to a known angle, and say so with --stage-at or "The stage stands at" on the page), and start a '
        "new run"
    )


@dataclass
class OwnGyro:
    """The gyro over a run.

    Attributes:
        along: which axis lies along the stage's, 0 to 2.
        last: the biases of the last two dwells.
        means_dps: those of all, x, y and z in turn, NaN where not known: packed, for a run may take weeks.
    """

    along: int
    earlier: InitVar[Sequence[GyroBias]] = ()
    last: deque[GyroBias] = field(default_factory=partial(deque, maxlen=2))
    means_dps: array[float] = field(default_factory=lambda: array("d"))

    def __post_init__(self, earlier: Sequence[GyroBias]) -> None:
        for bias in earlier:
            self._take(bias)

    def dwelt(self, dwell: Samples) -> float | None:
        """Takes a dwell; standard error of its bias about the stage's axis."""
        bias = dwell_bias(dwell.gyro_dps)
        self._take(bias)
        return bias.bias_std_dps[self.along]

    def _take(self, bias: GyroBias) -> None:
        self.last.append(bias)
        self.means_dps.extend(math.nan if axis is None else axis for axis in bias.bias_dps)

    def felt_deg(
        self, move: Samples, period_s: float, lasts_s: float, axis: int | None = None
    ) -> float | None:
        """The turn over the move into the last dwell about an axis, by the bias of the dwells beside it."""
        k = self.along if axis is None else axis
        bias_dps = _mean_dps(self.last, k)
        if bias_dps is None:
            return None
        return felt_move_deg(move.time_s, move.gyro_dps[:, k], bias_dps, period_s, lasts_s)

    def bias_with_dps(self, dwell: Samples) -> float:
        """About the stage's axis, the mean of the last dwell and of one that has not been taken yet."""
        beside = [*self.last, dwell_bias(dwell.gyro_dps)][-2:]
        return _mean_dps(beside, self.along) or 0.0

    def felt_about_axes_deg(self, move: Samples, period_s: float, lasts_s: float) -> dict[str, float | None]:
        """The turns over the move into the last dwell about each axis, as a pose's covariates."""
        return {name: self.felt_deg(move, period_s, lasts_s, axis) for axis, name in enumerate(GYRO_MOVES)}

    def figures(self, turned_deg: Sequence[float], felt_deg: Sequence[float]) -> Gyro:
        """What dwells and moves say: what the unit turned with each move, and what it felt."""
        if not self.last:
            return UNKNOWN_GYRO
        means_dps = np.frombuffer(self.means_dps).reshape(-1, 3)
        bias = self.last[0] if len(means_dps) == 1 else run_bias(means_dps)
        scale = gyro_scale(turned_deg, felt_deg)
        return Gyro(
            bias_dps=list(bias.bias_dps),
            bias_std_dps=list(bias.bias_std_dps),
            scale=None if scale is None else scale.scale,
            scale_std=None if scale is None else scale.scale_std,
        )


def _mean_dps(biases: Iterable[GyroBias], axis: int) -> float | None:
    """The mean of biases about an axis; None where they do not tell."""
    known = [bias_dps for bias in biases if (bias_dps := bias.bias_dps[axis]) is not None]
    return sum(known) / len(known) if known else None


FEWEST_FOR_TARGET_S = 0.5
"""A dwell with `target_std_deg` is at least this long: a standard error from less is itself a guess."""
DWELL_TRIES = 3
MOVED_DEG = 1e-4
"""A change of reported angle below this is no move."""


@dataclass
class PoseAcquisition:
    """The poses of a run so far, and what carries over from one to the next.

    `felt` is what the unit felt of the moves between them. `stopping_rule` tells where the plan need not be
    carried out whole, `is_enough` whether that is so by now. `returned` is what the last pose before an
    interruption gave when it was measured once more.
    """

    plan: Plan
    pace: AcquisitionLoop
    earlier: Earlier = field(default_factory=Earlier)
    stopping_rule: StoppingRule | None = None
    returned: Returned | None = None
    is_enough: bool = field(init=False)
    gyro: OwnGyro = field(init=False)
    felt: MoveMonitor = field(init=False)
    poses: list[Pose] = field(init=False)
    noise: KalmanNoise = field(init=False)
    filtering: Filtering | None = field(init=False)
    approach: int = 0

    def __post_init__(self) -> None:
        self.rig, self.recorder = self.pace.rig, self.pace.recorder
        self.poses = list(self.earlier.poses)
        self.gyro = OwnGyro(AXES.index(self.plan.mount_axis[-1]), self.earlier.biases)
        self.felt = MoveMonitor(self.poses, self.rig.board_identity.gyro_range_dps, self.plan.mount_axis)
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


TEMPERATURE_WAIT_S = 4 * 3600.0


def wait_before_sweep(plan: Plan, pace: AcquisitionLoop) -> None:
    """A time, then a die temperature, reached from whichever side."""
    end_s = pace.stream.clock_s + plan.wait_s
    while pace.stream.clock_s < end_s:
        pace.stand_by()
    wanted_c = plan.wait_temperature_c
    if wanted_c is not None:
        _wait_for_temperature(pace, wanted_c)


def _wait_for_temperature(pace: AcquisitionLoop, wanted_c: float) -> None:
    pace.synchronise()
    began_s, began_c = pace.stream.clock_s, pace.stream.temperature_c
    while (now_c := pace.stream.temperature_c) is not None and began_c is not None:
        if (now_c >= wanted_c) if began_c < wanted_c else (now_c <= wanted_c):
            return
        if pace.stream.clock_s - began_s > TEMPERATURE_WAIT_S:
            raise BoardError(
                f"the board has come from {began_c:.1f} °C to {now_c:.1f} °C and not to {wanted_c:g} °C "
                f"within {TEMPERATURE_WAIT_S / 3600:g} h; choose a temperature that it reaches"
            )
        pace.stand_by()
    raise BoardError("the plan waits for a temperature, and this board does not send one")
