"""A sweep: the stage turns slowly from end to end without stopping, and a pose is a stretch of its way.

Each pass ends with a dwell. Its poses follow once the stage stands: what the gyro has felt of the last part
of the way tells how late the stage's reports come (`calrig.estimation.turning`), and the dwell whether the
motor biases the accelerometer while it turns (`calrig.calibration.motor_vibration`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calrig.calibration.motor_vibration import Ends, UnreportedTurn, disturbing, end_differences
from calrig.estimation.reading import Reading
from calrig.estimation.turning import GyroTurn, clock_line, common_delay_s, scatter_g
from calrig.instruments.errors import BoardError, InstrumentError, StageError
from calrig.plan import Plan, PlannedPose
from calrig.runs.mounting import Mount
from calrig.runs.pace import Pace
from calrig.runs.pose_taking import DWELL_TRIES, PoseTaking
from calrig.runs.sweep_times import planned_times_s
from calrig.runs.sweep_waits import wait_before_sweep
from calrig.runs.turned_pass import Seen, TurnedPass

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
class Sweeping:
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
    pace: Pace
    taking: PoseTaking
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
        pace.begin(self.plan, moves=True, mount=Mount(0.0, "x"))
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
        """One pass, turned anew where it cannot be measured; makes and stores its poses.

        Raises:
            PassLost: it could not be measured `DWELL_TRIES` times over.
        """
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

    def _turned(
        self, seen: Seen, passed: list[PlannedPose], dwell_s: tuple[float, float]
    ) -> TurnedPass | None:
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
            clocks = clock_line(np.array(pace.clocks))
            turn = seen.even_turn(axis.run_up_deg() + RUN_UP_S * self.plan.turn_dps, clocks)
        except ValueError as error:
            raise UnevenTurn(
                f"the stage turned at {self.plan.turn_dps:g}°/s: {error}; take a plan of dwells, or another "
                "velocity"
            ) from error
        turned = TurnedPass(
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

    def _keep(self, turned: TurnedPass, passed: list[PlannedPose], reading: Reading) -> None:
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
            pose = taken.felt_as(taking.gyro.felt_deg(taken.move, 1.0 / self.pace.rate_hz, travel_s))
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
