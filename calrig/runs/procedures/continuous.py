"""Continuous sweep: the stage rotates slowly from end to end, and a pose is a segment of its travel.

Each traverse ends with a dwell; its poses are computed at standstill. The gyro over the last segment gives
the delay of the stage's reports (`calrig.estimation.turning`). The dwell shows whether motor vibration
biases the accelerometer (`calrig.calibration.motor_vibration`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calrig.calibration.motor_vibration import Ends, UnreportedTurn, disturbing, end_differences
from calrig.calibration.poses import Filtering, Pose
from calrig.estimation.angles import wrap_deg
from calrig.estimation.gyro import dwell_bias
from calrig.estimation.kalman import KalmanNoise
from calrig.estimation.reading import Reading, dwell_reading
from calrig.estimation.turning import (
    FEWEST_REPORTS,
    ClockLine,
    EvenTurn,
    GyroTurn,
    clock_line,
    common_delay_s,
    even_turn,
    filter_lag_deg,
    gyro_turn,
    hidden_dps,
    scatter_g,
    turn_between,
    turned_back,
)
from calrig.instruments.axis import Motion
from calrig.instruments.errors import BoardError, InstrumentError, StageError
from calrig.instruments.types import Samples
from calrig.model.plan import Plan, PlannedPose
from calrig.runs.acquisition import AcquisitionLoop, SampleSegment
from calrig.runs.mounting import Mounting
from calrig.runs.pose_acquisition import DWELL_TRIES, PoseAcquisition, pose_of, wait_before_sweep

FEWEST_OF_A_STRETCH = 0.5
"""Of its way and of its samples."""
PROMPT = 1.5
PROMPT_S = 0.005
"""Later than the prompt ones by no more than this, on a slow wire: 0.1 s is 0.5° at 10°/s. Some
letters more at 9600 baud must pass, for angles of one sign and size have them all."""
OUT_OF_STEP = 0.002
"""Share by which the gains of two passes may differ, beside what the gyro's bias makes of them by chance."""
CHANCE_STD = 5.0
MOST_PLAY_DEG = 1.5
UNEVEN_S = 0.02
"""Reports that scatter about a straight line by more than the way of so long are of no even turn."""


@dataclass(slots=True)
class Seen:
    """The stage's reports of a turn: the host's clock before a question and after its answer, the angle."""

    from_deg: float
    to_deg: float
    reports: list[tuple[float, float, float]] = field(default_factory=list)

    def note(self, motion: Motion) -> None:
        """Takes a look at the stage; one that has been told to move and has not set off reports no time."""
        if not math.isnan(motion.asked_s[0]):
            self.reports.append((*motion.asked_s, motion.elevation_deg))

    def even_turn(self, run_up_deg: float, clocks: ClockLine) -> EvenTurn:
        """The part between run-up and slowing down, in the board's time.

        Of the reports, those whose answer came as fast as of the fastest quarter (of a slow stage: as of the
        fewest that make a line): of the others it is not known so well of when they are.

        Raises:
            ValueError: the stage does not turn evenly, or too few of its reports say so; the message says it.
        """
        sense = 1.0 if self.to_deg > self.from_deg else -1.0
        asked_s, answered_s, angles_deg = np.array(self.reports, dtype=np.float64).reshape(-1, 3).T
        if len(asked_s) < 2:
            raise ValueError("the stage does not say where it is while it turns")
        took_s = answered_s - asked_s
        share = min(1.0, max(0.25, 2 * FEWEST_REPORTS / len(took_s)))
        quick_s = float(np.quantile(took_s, share))
        prompt = took_s <= min(PROMPT * quick_s, quick_s + PROMPT_S) + 1e-9
        times_s, angles_deg = clocks.board_s((asked_s + took_s / 2)[prompt]), angles_deg[prompt]
        near_deg, far_deg = self.from_deg + sense * run_up_deg, self.to_deg - sense * run_up_deg
        turn = even_turn(times_s, angles_deg, near_deg, far_deg)
        if turn.scatter_deg > UNEVEN_S * abs(turn.velocity_dps) or turn.velocity_dps * sense <= 0.0:
            raise ValueError(
                f"its reports scatter by {turn.scatter_deg:.2f}° about a line: it does not turn evenly"
            )
        return turn


@dataclass(frozen=True, slots=True)
class Taken:
    """A pose with the samples that it is made of, and those of the move into it.

    `place` is its own within the pass; `stage_move_deg` is what the stage says it turned since the pose
    before, and `before` are the samples between the two.
    """

    place: int
    pose: Pose
    samples: Samples
    before: Samples
    move: Samples
    stage_move_deg: float


@dataclass(frozen=True, slots=True)
class Traverse:
    """One pass from stand to stand.

    Attributes:
        kept: all samples since the stand before it, to the end of the dwell after it.
        stood_s, dwell_s: when it began, and begin and end of the dwell.
        from_deg, stands_deg: where the stage stood before and stands now.
        turn: by the stage's reports.
        clocks: which took their times to the board's.
        along: the gyro's axis that lies along the stage's.
        bias_dps: of that axis.
        noise, rate_hz: of the filter.
    """

    kept: SampleSegment
    stood_s: float
    dwell_s: tuple[float, float]
    from_deg: float
    stands_deg: float
    turn: EvenTurn
    clocks: ClockLine
    along: int
    bias_dps: float
    noise: KalmanNoise
    rate_hz: float

    def felt(self) -> GyroTurn:
        """The gyro's gain, and by how much the stage's reports are behind the samples."""
        samples = self.kept.between(self.stood_s, self.dwell_s[0]).samples
        rate_dps = samples.gyro_dps[:, self.along] - self.bias_dps
        return gyro_turn(samples.time_s, rate_dps, self.turn, self.stands_deg)

    def reports_stand_s(self) -> float:
        """When it came to its stand by the reports, in the host's time."""
        return self.clocks.host_s(self.turn.time_s(self.stands_deg))

    @property
    def hidden_dps(self) -> float:
        """By how much the gyro may be wrong for the steps that its rates are told in."""
        along = self.along
        return hidden_dps(self.dwell.gyro_dps[:, along], self.kept.samples.gyro_dps[:, along])

    def is_out_of_step(self, gain: float, before: Sequence[float]) -> bool:
        """Whether the clocks of host and board were not in step, for the machine was busy elsewhere.

        A gyro has one gain: that of the passes before, and from stand to stand, where no clock counts but the
        play does.
        """
        samples = self.kept.between(self.stood_s, self.dwell_s[0]).samples
        turned_deg = float(np.trapezoid(samples.gyro_dps[:, self.along] - self.bias_dps, samples.time_s))
        way_deg = self.stands_deg - self.from_deg
        bias_std_dps = dwell_bias(self.dwell.gyro_dps).bias_std_dps[self.along] or 0.0
        unsure_dps = CHANCE_STD * bias_std_dps + self.hidden_dps
        allowed = OUT_OF_STEP + unsure_dps / abs(self.turn.velocity_dps)
        if abs(gain * way_deg / turned_deg - 1.0) > allowed + MOST_PLAY_DEG / abs(way_deg):
            return True
        return bool(before) and abs(gain / float(np.median(before)) - 1.0) > allowed

    def too_short(self, stretches: list[PlannedPose]) -> PlannedPose | None:
        """The first stretch of which the even turn holds less than half."""
        for one in stretches:
            begin_s, end_s = self._span_s(one, 0.0)
            first_deg, last_deg = one.stretch_deg or (0.0, 0.0)
            lasts_s = abs((last_deg - first_deg) / self.turn.velocity_dps)
            if end_s - begin_s < FEWEST_OF_A_STRETCH * lasts_s:
                return one
        return None

    @property
    def dwell(self) -> Samples:
        """Of the dwell at its end."""
        return self.kept.between(*self.dwell_s).samples

    @property
    def even_samples(self) -> Samples:
        """Of the even part of the turn."""
        return self.kept.between(self.turn.begins_s, self.turn.ends_s).samples

    def lacks_samples(self, stretches: list[PlannedPose]) -> bool:
        """Whether more than half of a stretch's samples are missing."""
        spans = [self._span_s(one, 0.0) for one in stretches]
        counts = [len(self.kept.between(*span).samples) for span in spans]
        return any(
            n < max(2, FEWEST_OF_A_STRETCH * (end_s - begin_s) * self.rate_hz)
            for n, (begin_s, end_s) in zip(counts, spans, strict=True)
        )

    def unreported_turn(self, last: PlannedPose, felt: GyroTurn, bias_std_dps: float) -> UnreportedTurn:
        """What the gyro says of the end beyond the stage's reports, from the last stretch to the dwell.

        `felt` has the gyro's gain and the delay.
        """
        stretch_s = self._span_s(last, felt.behind_s)
        samples = self.kept.between(stretch_s[0], self.dwell_s[1]).samples
        rate_dps = (samples.gyro_dps[:, self.along] - self.bias_dps) / felt.gain
        turned_deg, std_deg = turn_between(samples.time_s, rate_dps, stretch_s, self.dwell_s, bias_std_dps)
        turning_s = samples.time_s[samples.time_s <= stretch_s[1]]
        was_deg = float(self.turn.elevation_deg(turning_s + felt.behind_s).mean())
        sense = 1 if self.turn.velocity_dps > 0.0 else -1
        return UnreportedTurn(sense, turned_deg - (self.stands_deg - was_deg), std_deg)

    def poses(
        self, planned: list[PlannedPose], reading: Reading, felt: GyroTurn, settle_s: float
    ) -> Iterator[Taken]:
        """The poses of its stretches in the order turned, then that of the dwell.

        `felt` has the gyro's gain, what the filter shows of which is taken off, and the delay.
        """
        whole = self.kept.samples
        rate_dps = whole.gyro_dps[:, self.along] - self.bias_dps
        lag_deg = filter_lag_deg(whole.time_s, rate_dps, felt.gain - 1.0, self.noise)
        stage_deg, moved_s, ended_s = self.from_deg, self.stood_s, -np.inf
        for place, one in enumerate(planned):
            begin_s, end_s = self._span_s(one, felt.behind_s)
            if one.stretch_deg is None:
                read, samples, at_deg = reading, self.dwell, self.stands_deg
            else:
                read, samples, at_deg = self._read(begin_s, end_s, felt.behind_s)
            first, last = np.searchsorted(whole.time_s, (begin_s, end_s))
            pose = replace(
                pose_of(one, samples, read),
                target_deg=one.target_deg
                if one.stretch_deg is None
                else round(at_deg, 6),  # none is commanded
                reading_deg=wrap_deg(read.reading_deg - float(lag_deg[first:last].mean())),
                approach=1 if self.turn.velocity_dps > 0.0 else -1,
                time_s=(begin_s + end_s) / 2,
                stage_deg=at_deg,
                settle_s=settle_s if one.stretch_deg is None else None,
                filtering=Filtering(self.noise, self.rate_hz, end_s - begin_s, remembers=False),
            )
            at_s = begin_s if one.stretch_deg is None else float(samples.time_s.mean())
            yield Taken(
                place,
                pose,
                before=whole.between(ended_s, begin_s),
                samples=whole.between(begin_s, end_s),
                move=whole.spanning(moved_s, at_s),
                stage_move_deg=at_deg - stage_deg,
            )
            stage_deg, moved_s, ended_s = at_deg, at_s, end_s

    def _span_s(self, one: PlannedPose, behind_s: float) -> tuple[float, float]:
        """Begin and end of a pose by the samples' time."""
        if one.stretch_deg is None:
            return self.dwell_s
        begin_s, end_s = (self.turn.time_s(elevation_deg) for elevation_deg in one.stretch_deg)
        return max(begin_s, self.turn.begins_s) - behind_s, min(end_s, self.turn.ends_s) - behind_s

    def _read(self, begin_s: float, end_s: float, behind_s: float) -> tuple[Reading, Samples, float]:
        """Reading of a stretch, its samples turned back to its middle, and where the stage was there."""
        stretch = self.kept.between(begin_s, end_s)
        samples = stretch.samples
        at_deg = self.turn.elevation_deg(samples.time_s + behind_s)
        stage_deg = float(at_deg.mean())
        turned_deg = at_deg - stage_deg
        reading = dwell_reading(
            samples.time_s,
            stretch.elevation_deg - turned_deg,
            samples.gyro_dps[:, self.along],
            stretch.filtered_deg - turned_deg,
            self.noise,
        )
        return reading, replace(samples, accel_g=turned_back(samples.accel_g, turned_deg)), stage_deg


def planned_times_s(plan: Plan, planned: Sequence[PlannedPose], stored: int, first_s: float) -> list[float]:
    """Times of the poses, s; those of a pass are told together at its end, its first one for all of them.

    `stored` is how many of them an interrupted run has stored; a pass that is turned anew counts from there.
    `first_s` is that of the move to the first one.
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


CHANCE, CHANCE_SHAKEN = 1e-4, 1e-2
"""A difference of turning and standing so improbable ends a run; the sooner where the unit is shaken."""
UNTRUSTED = (
    "samples of a stretch were missing, or the stage's reports came too late to be trusted; check cables and "
    "rate, and let this machine do nothing else meanwhile"
)
SHAKEN = 1.1
"""Times the scatter standing: what a vibration of half the chip's noise makes of it."""
RUN_UP_S = 0.15
"""After the stage has come up to its velocity, and before it slows down: its reports and the board's lag."""

FEWEST_PASSES = 2
"""One in each sense: what play and delay do to the bias then cancels out."""

COARSEST_DPS = 0.1
"""What the steps of its rates may hide: 0.01° over the end of a turn, by which the delay is told."""


class PassLost(InstrumentError):  # noqa: N818 (what became of a pass, which may end a run well)
    """A pass cannot be measured, however often it is repeated; the message says why."""


class UnevenTurn(StageError):  # noqa: N818 (likewise)
    """The stage did not turn evenly by its reports and the clocks, or one of the three stood for a while."""


@dataclass
class ContinuousSweep:
    """A plan of kind `sweep` and the poses that it takes.

    Attributes:
        ends: turning less standing, by all poses so far.
        felt: of each pass.
        unreported: of each pass.
        stands_s: of each pass, as `common_delay_s` has them.
        scatter_g: of the accelerometer in each pass, turning and standing, RMS.
        restarts: of the board, by the last look.
        lost: why the run ended before the last pass, for a person; None where it did not.
    """

    plan: Plan
    pace: AcquisitionLoop
    taking: PoseAcquisition
    ends: Ends = field(default_factory=Ends)
    felt: list[GyroTurn] = field(default_factory=list)
    unreported: list[UnreportedTurn] = field(default_factory=list)
    stands_s: list[tuple[float, float]] = field(default_factory=list)
    scatter_g: list[tuple[float, float]] = field(default_factory=list)
    restarts: int = 0
    lost: str | None = None

    def carry_out(self, planned: list[PlannedPose]) -> None:
        """Homes the stage where it must be, dwells at one end, then takes the passes that are left.

        A pass that cannot be measured ends it; so many before it as `FEWEST_PASSES` are a result.

        Raises:
            Ended: the run was asked to end.
            InstrumentError: a device failed, the stage does not turn evenly from the first pass on, or its
                motor biases the accelerometer while it turns; the poses so far are stored.
            NotTheSame: after an interruption the last pose reads otherwise by far.
        """
        taking, pace = self.taking, self.pace
        if taking.is_enough:
            return
        pace.begin(self.plan, moves=True, mount=Mounting(0.0, "x"))
        if taking.poses:
            taking.return_to_last()
        else:
            taking.move_off(planned)
        first_s = pace.rig.axis.travel_s(planned[0].target_deg - (pace.stage_deg or 0.0))
        pace.recorder.poses_begin(planned_times_s(self.plan, planned, len(taking.poses), first_s))
        if not taking.poses:
            wait_before_sweep(self.plan, pace)
            taking.take(planned[0], self.plan.first_settle_s)
            pace.hold_while_paused()
        self._began_anew()
        for passed in self._passes(planned):
            if passed[0].sweep > 0:
                wait_before_sweep(self.plan, pace)
            try:
                self._take(planned[passed[0].index - 1].target_deg, passed)
            except PassLost as why:
                if passed[0].sweep < FEWEST_PASSES or len(taking.poses) != passed[0].index:
                    raise
                self.lost = f"The run ended after {passed[0].sweep} of {self.plan.sweeps} passes: {why}."
                pace.recorder.end_here()
                return
            if taking.is_enough:
                return
            pace.hold_while_paused()

    def _passes(self, planned: list[PlannedPose]) -> Iterator[list[PlannedPose]]:
        """The stretches of each pass and the dwell at its end, but for passes that are stored whole."""
        passed: list[PlannedPose] = []
        for pose in planned[1:]:
            passed.append(pose)
            if pose.stretch_deg is None:
                if pose.index >= len(self.taking.poses):
                    yield passed
                passed = []

    def _take(self, from_deg: float, passed: list[PlannedPose]) -> None:
        """One pass, turned anew where it cannot be measured; makes and stores its poses."""
        end, why = passed[-1], ""
        for _ in range(DWELL_TRIES):
            self._go_to(from_deg)
            seen = self._turn(end.target_deg)
            start_s, end_s, reading = self.taking.measure(
                f"pose {end.index}", end.target_deg, self.plan.settle_s
            )
            self.pace.see_that_it_stands()
            why = UNTRUSTED
            try:
                turned = None if self._began_anew() else self._turned(seen, passed, (start_s, end_s))
            except UnevenTurn as error:
                turned, why = None, str(error)
            if turned is not None:
                self._keep(turned, passed, reading)
                self.pace.forget(end_s)
                return self._hold_against_the_dwells()
            self.pace.rig.board.faults["retried_pose"] += 1
            self.pace.clocks.clear()  # one that stood for a while lies on two lines, before and after
        raise PassLost(f"the pass from {from_deg:g}° to {end.target_deg:g}°, {DWELL_TRIES} times over: {why}")

    def _began_anew(self) -> bool:
        """Whether the board was reset since the last look: its time goes on by the host's, no line does."""
        faults = self.pace.rig.board.faults
        before, self.restarts = self.restarts, faults["board_reset"] + faults["restarted"]
        if self.restarts != before:
            self.pace.clocks.clear()
            self.stands_s.clear()
        return self.restarts != before

    def _go_to(self, from_deg: float) -> None:
        """Moves to where a pass begins, where the stage does not stand there."""
        if abs((self.pace.stage_deg or 0.0) - from_deg) > self.pace.rig.axis.tolerance_deg:
            self.pace.move(from_deg)
            self.pace.forget(self.pace.synchronise())
            self.taking.felt.touched()

    def _turn(self, to_deg: float) -> Seen:
        """One pass at the plan's velocity, the stage's reports and both clocks taken down."""
        pace = self.pace
        seen = Seen(pace.rig.axis.elevation_deg(), to_deg)
        pace.rig.axis.set_velocity(self.plan.turn_dps)
        pace.move(to_deg, seen.note)
        self.taking.note_approach(seen.from_deg)
        return seen

    def _turned(self, seen: Seen, passed: list[PlannedPose], dwell_s: tuple[float, float]) -> Traverse | None:
        """The pass by reports and gyro; None where samples are missing, or the clocks were out of step.

        Raises:
            UnevenTurn: the stage's reports lie on no line.
            InstrumentError: stage or board can take no pass so.
        """
        pace, taking, axis = self.pace, self.taking, self.pace.rig.axis
        kept = pace.stream.kept()
        dwell = kept.between(*dwell_s).samples
        if np.isnan(kept.samples.accel_g).any() or np.isnan(kept.samples.gyro_dps).any():
            raise BoardError(
                f"board {taking.rig.board_identity.driver} sends no rates and accelerations, which a sweep "
                "needs: take a plan of dwells"
            )
        bias_dps = taking.gyro.bias_with_dps(dwell)
        try:
            clocks = clock_line(pace.clocks.pairs_s)
            turn = seen.even_turn(axis.run_up_deg() + RUN_UP_S * self.plan.turn_dps, clocks)
        except ValueError as error:
            raise UnevenTurn(
                f"the stage turned at {self.plan.turn_dps:g}°/s: {error}; take a plan of dwells, or another "
                "velocity"
            ) from error
        turned = Traverse(
            kept, pace.stood_at_s, dwell_s, seen.from_deg, pace.stage_deg or seen.to_deg, turn,
            clocks, taking.gyro.along, bias_dps, taking.noise, pace.rate_hz,
        )  # fmt: skip
        if (short := turned.too_short(passed[:-1])) is not None:
            raise StageError(
                f"the stage comes up to {self.plan.turn_dps:g}°/s and slows down within the stretch about "
                f"{short.target_deg:g}°: take longer stretches (step_deg), or a lower velocity"
            )
        if turned.hidden_dps > COARSEST_DPS:
            raise BoardError(
                f"the gyro of board {taking.rig.board_identity.driver} tells rates in steps of "
                f"{2 * turned.hidden_dps:.2g}°/s: too coarse to time a turn by; take a plan of dwells"
            )
        gains = [felt.gain for felt in self.felt]
        if turned.lacks_samples(passed[:-1]) or turned.is_out_of_step(turned.felt().gain, gains):
            return None
        return turned

    def _keep(self, turned: Traverse, passed: list[PlannedPose], reading: Reading) -> None:
        """Makes and stores the poses that are not stored yet, by gain and delay of all passes so far."""
        taking = self.taking
        self.felt.append(turned.felt())
        self.stands_s.append((turned.reports_stand_s(), self.felt[-1].stands_s))
        felt = replace(
            self.felt[-1],
            gain=float(np.mean([one.gain for one in self.felt])),
            behind_s=common_delay_s(np.array(self.stands_s), turned.clocks, self.felt[-1].behind_std_s),
        )
        bias_std_dps = taking.gyro.dwelt(turned.dwell)
        of_two_dps = (bias_std_dps or 0.0) / math.sqrt(2.0)  # the bias is the mean of two dwells'
        self.unreported.append(turned.unreported_turn(passed[-2], felt, of_two_dps))
        self.scatter_g.append((scatter_g(turned.even_samples.accel_g), scatter_g(turned.dwell.accel_g)))
        for taken in turned.poses(passed, reading, felt, self.plan.settle_s):
            if passed[0].index + taken.place < len(taking.poses):
                continue
            travel_s = abs(taken.stage_move_deg) / self.plan.turn_dps
            felt_deg = taking.gyro.felt_deg(taken.move, 1.0 / self.pace.rate_hz, travel_s)
            pose = replace(taken.pose, gyro_move_deg=felt_deg)
            lasts_s = float(np.ptp(turned.dwell.time_s))
            check = taking.felt.take(pose, taken.stage_move_deg, taken.move, bias_std_dps, lasts_s)
            taking.keep(pose, taken.before, taken.samples, check)

    def _hold_against_the_dwells(self) -> None:
        """Ends the run where the unit reads otherwise while the motor turns than standing."""
        turning_g, standing_g = np.sqrt(np.mean(np.square(self.scatter_g), axis=0)).tolist()
        shaken = turning_g > SHAKEN * standing_g
        self.ends = end_differences(self.taking.poses, self.unreported)
        worst = disturbing(self.ends, CHANCE_SHAKEN if shaken else CHANCE)
        if worst is not None:
            said = (
                f"reads {worst.difference_deg:+.3f}° ± {2 * worst.std_deg:.3f}° more than standing, and "
                f"scatters by {1000 * turning_g:.1f} mg, not {1000 * standing_g:.1f} mg"
            )
            raise StageError(
                f"the motor biases the accelerometer while it turns at {self.plan.turn_dps:g}°/s: at "
                f"{worst.elevation_deg:g}° the unit {said}; take a plan of dwells, or another velocity"
            )

    def provenance(self) -> dict[str, Any]:
        """What is kept with the run: CONTRACT section 9 asks for latency and for the ends."""
        return {
            "velocity_dps": self.plan.turn_dps,
            "passes": [{"gyro_gain": f.gain, "reports_behind_s": f.behind_s} for f in self.felt],
            "scatter_g": [{"turning": turning, "standing": standing} for turning, standing in self.scatter_g],
            "turning_less_standing": [end.document() for end in self.ends.differences],
            **({} if self.lost is None else {"lost": self.lost}),
        }
