"""A stage as an axis of elevation: zero, sign, ratio, soft limits, and moves watched until they end."""

import contextlib
import math
from dataclasses import dataclass, field

from calrig.instruments.clock import WALL, Clock
from calrig.instruments.errors import Halted, InstrumentError, LimitError, StageError
from calrig.instruments.standstill import IN_MOTION, confirm_standstill
from calrig.instruments.types import Stage, StageIdentity, StageStatus


@dataclass(slots=True)
class Goal:
    """What the axis was sent to do: a target, or None for the reference; and what it must not overstep."""

    target_deg: float | None
    deadline_s: float
    stall_s: float
    progress_s: float
    progress_deg: float
    from_deg: float = 0.0
    off_since_s: float | None = None

    @property
    def words(self) -> str:
        """What it is about, as it is said in an error."""
        return "homing" if self.target_deg is None else f"the move to {self.target_deg:g}°"

    def is_astray(self, elevation_deg: float, slack_deg: float) -> bool:
        """Whether this is off the way from where the axis was to its target, by more than `slack_deg`."""
        if self.target_deg is None:
            return False
        low, high = sorted((self.from_deg, self.target_deg))
        return not low - slack_deg <= elevation_deg <= high + slack_deg


def travel_time_s(distance_deg: float, velocity_dps: float, acceleration_dps2: float) -> float:
    """The time of a move with trapezoidal velocity, triangular where it is too short to reach the plateau."""
    if distance_deg * acceleration_dps2 < velocity_dps**2:
        return 2 * math.sqrt(distance_deg / acceleration_dps2)
    return distance_deg / velocity_dps + velocity_dps / acceleration_dps2


HOME_TIMEOUT_S = 120.0
MOVE_MARGIN_S = 5.0
GRACE_S = 1.0
STALL_S = 3.0
STALL_DEG = 0.05
ASSUMED_VELOCITY_DPS = 1.0
OVERSHOOT_DEG = 1.0  # beyond the tolerance: no move as commanded goes so far off its path


@dataclass(frozen=True, slots=True)
class Motion:
    """One look at an axis: where it is, and whether it is still on its way.

    `asked_s` is the clock's time before the question for the angle and after the answer.
    """

    elevation_deg: float
    moving: bool
    asked_s: tuple[float, float] = field(default=(math.nan, math.nan), compare=False)


class Axis:
    """elevation = sign · (stage − zero_deg) / ratio (CONTRACT section 3).

    One thread moves and polls; any thread may halt. `has_moved` tells whether a motion was ever commanded.

    Args:
        zero_deg: the stage's angle at elevation 0.
        sign: +1 or −1.
        ratio: stage degrees per degree of elevation.
        limits_deg: soft limits of elevation, lower then upper.
        tolerance_deg: how far from its target, in elevation, a move may end.
        clock: of the stage's port.
    """

    def __init__(
        self,
        stage: Stage,
        *,
        zero_deg: float = 0.0,
        sign: int = 1,
        ratio: float = 1.0,
        limits_deg: tuple[float, float] = (-90.0, 90.0),
        tolerance_deg: float = 0.3,
        clock: Clock = WALL,
    ) -> None:
        self.stage = stage
        self.limits_deg = limits_deg
        self._zero_deg = zero_deg
        self._gain = sign * ratio
        self.tolerance_deg = tolerance_deg
        self._clock = clock
        self._limits_of = "the rig's soft limits"
        self._velocity_dps: float | None = None
        self._velocity_before_dps: float | None = None
        self._acceleration_dps2: float | None = None
        self._goal: Goal | None = None
        self._rests_deg: float | None = None  # where the last move has ended
        self._halted = False
        self.has_moved = False

    def identify(self) -> StageIdentity:
        """Asks the stage who it is; its controller's own limits narrow `limits_deg` from here on.

        Raises:
            StageError: it does not answer, is disabled, or its limits leave nothing of the soft limits.
        """
        identity = self.stage.identify()
        self._velocity_dps = identity.velocity_dps
        self._acceleration_dps2 = identity.acceleration_dps2
        if identity.limits_deg is not None:
            ends = sorted(self._to_elevation(limit) for limit in identity.limits_deg)
            low, high = max(self.limits_deg[0], ends[0]), min(self.limits_deg[1], ends[1])
            if low > high:
                raise StageError(
                    f"the controller allows elevations {ends[0]:g}° to {ends[1]:g}° only, all of them beyond "
                    f"{self._limits_of} {self.limits_deg[0]:g}° to {self.limits_deg[1]:g}°: "
                    "check zero_deg, sign and ratio"
                )
            if (low, high) != self.limits_deg:
                self._limits_of = "the limits of rig and controller together,"
            self.limits_deg = low, high
        return identity

    def needs_home(self) -> bool:
        """Whether the stage has no reference, or is just looking for it (StageError if it cannot be used)."""
        status = self.stage.status()
        self._require_usable(status)
        return status.state in ("not_referenced", "homing")

    def begin_home(self) -> None:
        """Begins to look for the reference, or waits for a search that is already under way."""
        if self.stage.status().state != "homing":
            self.has_moved, self._rests_deg = True, None
            self.stage.home()
        now = self._clock.now_s()
        self._goal = Goal(None, now + HOME_TIMEOUT_S, HOME_TIMEOUT_S, now, math.inf)

    def begin_move(self, elevation_deg: float) -> None:
        """Begins a move; `poll` tells how it goes on.

        Raises:
            LimitError: the target lies beyond `limits_deg` or is no number; nothing was sent.
            StageError: the controller refused it.
            Halted: the axis was halted; nothing was sent.
        """
        low, high = self.limits_deg
        if not low <= elevation_deg <= high:
            raise LimitError(
                f"elevation {elevation_deg:g}° is beyond {self._limits_of} {low:g}° to {high:g}°; "
                "nothing was sent to the stage"
            )
        here = self.elevation_deg() if self._rests_deg is None else self.see_that_it_stands(self._rests_deg)
        self.has_moved, self._rests_deg = True, None
        self.stage.move(self._zero_deg + self._gain * elevation_deg)
        velocity, travel_s = self._velocity_dps or ASSUMED_VELOCITY_DPS, self.travel_s(elevation_deg - here)
        now = self._clock.now_s()
        self._goal = Goal(
            target_deg=elevation_deg,
            deadline_s=now + 2 * travel_s + MOVE_MARGIN_S,
            stall_s=max(STALL_S, 4 * STALL_DEG / velocity),
            progress_s=now,
            progress_deg=here,
            from_deg=here,
        )

    def travel_s(self, turn_deg: float) -> float:
        """The time that the stage needs to turn so far, by what its controller says of itself."""
        velocity = self._velocity_dps or ASSUMED_VELOCITY_DPS
        return travel_time_s(abs(self._gain * turn_deg), velocity, self._acceleration_dps2 or velocity)

    def run_up_deg(self) -> float:
        """The way, in elevation, on which the stage comes up to its velocity, by what its controller says."""
        velocity = self._velocity_dps or ASSUMED_VELOCITY_DPS
        return velocity**2 / (2.0 * (self._acceleration_dps2 or velocity) * abs(self._gain))

    def poll(self) -> Motion:
        """Looks once, waiting for nothing but the stage's answers.

        Raises:
            StageError: the stage is disabled, stalls, takes longer than distance, velocity and acceleration
                allow, or stands elsewhere than it was sent to.
            Halted: the axis was halted.
        """
        if self._halted:
            raise Halted("the stage was halted: it takes no motion until it is opened again")
        status = self.stage.status()
        self._require_usable(status)
        if status.state in IN_MOTION:
            asked_s = self._clock.now_s()
            glimpse_deg = self._glimpse_deg()
            motion = Motion(glimpse_deg, moving=True, asked_s=(asked_s, self._clock.now_s()))
            self._check_way(motion.elevation_deg)
            self._check_progress(motion.elevation_deg, status)
            return motion
        elevation = self.elevation_deg()
        moving = not self._is_in_place(elevation, status)
        return Motion(elevation, moving)

    def elevation_deg(self) -> float:
        """Where the standing stage says it is, in elevation."""
        return self._to_elevation(self.stage.position_deg())

    def stands_at(self, elevation_deg: float) -> None:
        """Takes a standing stage's word for a new zero: it counts from elsewhere than when it was left."""
        self._zero_deg = self.stage.position_deg() - self._gain * elevation_deg

    def see_that_it_stands(self, stood_deg: float) -> float:
        """Where a stage stands that was told nothing since it stood at `stood_deg`.

        Raises:
            StageError: it is disabled, reports motion, or is elsewhere by more than the tolerance.
        """
        for last in (False, True):  # one answer may have been damaged on the wire
            status = self.stage.status()
            if status.state in IN_MOTION:
                said = f"says {status.words}"
            else:
                self._require_usable(status)
                now_deg = self.elevation_deg()
                if abs(now_deg - stood_deg) <= self.tolerance_deg:
                    return now_deg
                said = f"stands at {now_deg:g}°"
            if last:
                break
        raise StageError(
            f"the stage stood at {stood_deg:g}° and now {said}, without being told to move: look for a "
            "second program, a keypad or a slipping drive"
        )

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity, in elevation, of the moves that follow; `close` restores the one before."""
        before = self._velocity_dps
        self.stage.set_velocity(velocity_dps * abs(self._gain))
        self._velocity_dps = velocity_dps * abs(self._gain)
        if self._velocity_before_dps is None:
            self._velocity_before_dps = before

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""
        self._halted = True
        self.stage.halt()

    def confirm_stopped(self, timeout_s: float) -> None:
        """Halt, and repeat the stop until two consecutive reports show the stage at rest at one angle.

        Raises:
            StageError: it still moves, whatever it says of itself, or does not answer, after timeout_s: only
                cutting its power is left.
            PortError: the port is gone.
        """
        self._halted = True
        confirm_standstill(self.stage, self._clock, timeout_s)

    def close(self) -> None:
        """Restores the velocity found and closes the port; never raises."""
        if self._velocity_before_dps is not None:
            # A stage that no longer answers keeps it only until its next reset.
            with contextlib.suppress(InstrumentError):
                self.stage.set_velocity(self._velocity_before_dps)
        self.stage.close()

    def _to_elevation(self, stage_deg: float) -> float:
        return (stage_deg - self._zero_deg) / self._gain

    def _require_usable(self, status: StageStatus) -> None:
        if status.state in ("disabled", "configuration"):
            during = f" during {self._goal.words}" if self._goal else ""
            raise StageError(
                f"the stage is in {status.words}{during}: look for an obstacle, a limit switch or a motor "
                "power cut, then start again"
            )

    def _glimpse_deg(self) -> float:
        return self._to_elevation(self.stage.glimpse_deg())

    def _check_way(self, elevation_deg: float) -> None:
        """Stop a stage that two reports in a row place outside the way from its start to its target.

        Its position is then read with all checks, since a controller that was reset reports a false count.
        """
        goal, slack_deg = self._goal, self.tolerance_deg + OVERSHOOT_DEG
        if goal is None or not goal.is_astray(elevation_deg, slack_deg):
            return
        if goal.is_astray(self._glimpse_deg(), slack_deg):
            self.halt()
            try:
                stopped_deg = self.elevation_deg()
            except StageError as error:
                raise StageError(f"{goal.words} from {goal.from_deg:g}° was stopped: {error}") from error
            raise StageError(
                f"{goal.words} from {goal.from_deg:g}° went astray and was stopped near {stopped_deg:.3f}°: "
                "check the cable to the controller, and that nobody else moves the stage"
            )

    def _check_progress(self, elevation_deg: float, status: StageStatus) -> None:
        goal, now = self._goal, self._clock.now_s()
        if goal is None:
            return  # motion from elsewhere: a keypad's, or that of an earlier process
        goal.off_since_s = None
        if abs(elevation_deg - goal.progress_deg) * abs(self._gain) > STALL_DEG:
            goal.progress_s, goal.progress_deg = now, elevation_deg
        if now - goal.progress_s > goal.stall_s:
            raise StageError(
                f"{goal.words} stalled at {elevation_deg:.3f}°: the stage says {status.words} and has not "
                f"turned for {now - goal.progress_s:.0f} s"
            )
        if now > goal.deadline_s:
            raise StageError(
                f"{goal.words} took too long: the stage still says {status.words} at {elevation_deg:.3f}°"
            )

    def _is_in_place(self, elevation_deg: float, status: StageStatus) -> bool:
        goal, now = self._goal, self._clock.now_s()
        if goal is None:
            return True
        if status.state == "ready":
            if goal.target_deg is None:
                self._goal = None
                return True
            if abs(elevation_deg - goal.target_deg) <= self.tolerance_deg:
                goal.off_since_s, goal.deadline_s = None, math.inf
                self._rests_deg = elevation_deg
                return True
        goal.off_since_s = now if goal.off_since_s is None else goal.off_since_s
        if now - goal.off_since_s > GRACE_S:
            raise StageError(
                f"{goal.words} did not succeed: the stage stands at {elevation_deg:.3f}° "
                f"and says {status.words}"
            )
        return False
