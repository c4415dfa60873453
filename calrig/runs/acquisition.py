"""Acquire and filter samples while stage and board are polled and requests are obeyed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from calrig.estimation.angles import AXES, along_axis, elevation_deg, wrap_deg
from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.instruments.axis import Motion
from calrig.instruments.types import GAP_PERIODS, Board, FloatArray, Samples
from calrig.model.plan import Plan
from calrig.runs.control import ENDED, Control, ResumeRequest
from calrig.runs.mounting import Mounting, OwnErrors, angle_about_deg
from calrig.runs.recorder import Recorder
from calrig.runs.rig import Rig
from calrig.store import SampleBlock
from calrig.store.trail import Act

Phase = Literal["move", "dwell"]


@dataclass(frozen=True, slots=True)
class SampleSegment:
    """Samples in a row with what the filter made of them, all (n,)-long.

    Attributes:
        elevation_deg: atan2(accel_y, accel_z) of each, or the angle that the board sends instead; about
            another axis likewise (`along_axis`).
        filtered_deg: the filter's angle after each, continuous; where the board sends no rate to filter with,
            the elevation, which it has filtered itself.
    """

    samples: Samples
    elevation_deg: FloatArray
    filtered_deg: FloatArray

    def between(self, from_s: float, to_s: float) -> SampleSegment:
        """The part with from_s <= time_s < to_s."""
        first, last = np.searchsorted(self.samples.time_s, (from_s, to_s))
        return SampleSegment(
            self.samples.between(from_s, to_s), self.elevation_deg[first:last], self.filtered_deg[first:last]
        )

    @classmethod
    def join(cls, parts: list[SampleSegment]) -> SampleSegment:
        """The parts one after the other."""
        return cls(
            Samples.join([p.samples for p in parts]),
            np.concatenate([p.elevation_deg for p in parts]) if parts else np.empty(0),
            np.concatenate([p.filtered_deg for p in parts]) if parts else np.empty(0),
        )


class Stream:
    """Takes samples from a started board, runs the filter over them, keeps them since the last cut.

    `begins_s` is the run's time when the board's clock stands at 0; `axis` is the unit's that lies along the
    stage's.
    """

    def __init__(
        self,
        board: Board,
        kalman: KalmanFilter,
        begins_s: float = 0.0,
        count: Callable[[int], None] = lambda _taken: None,
        axis: str = "x",
    ) -> None:
        self._board = board
        self._axis = axis
        self._count = count
        self._begins_s = begins_s
        self._kalman = kalman
        self._kept: list[SampleSegment] = []
        self._filtered_deg: float | None = None
        self.clock_s = 0.0
        self.reading_deg: float | None = None
        self.temperature_c: float | None = None

    def pump(self, timeout_s: float) -> int:
        """Takes what the board has sent, waiting up to timeout_s for it; returns how many samples came."""
        samples = self._board.take(timeout_s)
        if len(samples) == 0:
            return 0
        samples = replace(samples, time_s=samples.time_s + self._begins_s)
        computed = samples.angle_deg
        elevation = np.where(
            np.isnan(computed), elevation_deg(along_axis(samples.accel_g, self._axis)), computed
        )
        filtered = self._filtered(samples, elevation)
        self._kept.append(SampleSegment(samples, elevation, filtered))
        self.clock_s = float(samples.time_s[-1])
        self._filtered_deg = float(filtered[-1])
        self.reading_deg = wrap_deg(self._filtered_deg)
        temperature = float(samples.temperature_c[-1])
        self.temperature_c = None if np.isnan(temperature) else temperature
        self._count(len(samples))
        return len(samples)

    def _filtered(self, samples: Samples, elevation: FloatArray) -> FloatArray:
        rate_dps = samples.gyro_dps[:, AXES.index(self._axis[-1])]
        if not np.isnan(rate_dps).any():
            return self._kalman.run(samples.time_s, elevation, rate_dps)
        before = elevation[0] if self._filtered_deg is None else self._filtered_deg
        return np.unwrap(np.append(before, elevation), period=360.0)[1:]

    def reading_at(self, at_s: float) -> float | None:
        """The reading at a time of the board's clock not long ago, between the samples about it."""
        last = SampleSegment.join(self._kept[-2:])
        if not len(last.samples):
            return self.reading_deg
        return wrap_deg(float(np.interp(at_s, last.samples.time_s, last.filtered_deg)))

    def kept(self) -> SampleSegment:
        """Everything since the last cut."""
        if len(self._kept) > 1:
            self._kept = [SampleSegment.join(self._kept)]
        return self._kept[0] if self._kept else SampleSegment.join([])

    def cut(self, before_s: float) -> None:
        """Forgets the samples before a time of the board's clock."""
        self._kept = [self.kept().between(before_s, np.inf)]


def block_of(index: int, phase: Phase, samples: Samples) -> SampleBlock:
    """The samples as the store takes them, with the board's own angle where it sends one."""
    return SampleBlock(
        index,
        phase,
        samples.time_s,
        samples.accel_g,
        samples.gyro_dps,
        samples.temperature_c,
        None if np.isnan(samples.angle_deg).all() else samples.angle_deg,
    )


LOOK_S = 0.02
"""How long one look waits for samples before it turns to stage and requests again."""
GRAVITY_S = 0.5
"""How long gravity is averaged, where it is held against a stage that cannot home or a mount."""
MOST_CLOCKS = 4000
"""Pairs of the two clocks that are kept at least: some minutes of looks."""
LATELY = 50
"""Newest of these pairs: two seconds of looks."""
WATCH_S = 0.5
"""How often a stage that is to stand is asked whether it does."""


class SeenClocks:
    """The newest pairs of the host's clock and the board's at the last sample seen by then."""

    def __init__(self) -> None:
        self._pairs = np.empty((2 * MOST_CLOCKS, 2))  # as objects those of twenty rigs took 10 MB
        self._count = 0

    def append(self, host_s: float, board_s: float) -> None:
        """Takes a pair; of twice as many as are kept the older half goes."""
        if self._count == len(self._pairs):
            self._pairs[:MOST_CLOCKS] = self._pairs[MOST_CLOCKS:]
            self._count = MOST_CLOCKS
        self._pairs[self._count] = host_s, board_s
        self._count += 1

    def clear(self) -> None:
        """Forgets all."""
        self._count = 0

    @property
    def pairs_s(self) -> FloatArray:
        """(k, 2) in the order seen."""
        return self._pairs[: self._count]


@dataclass
class AcquisitionLoop:
    """The samples that come, the angle the stage last reported, and since when it has stood.

    Attributes:
        clock_s: of the run when the board's clock stands at 0.
        stage_deg: elevation last reported, None before the first report.
        stood_at_s: board's clock at an instant at which the stage stood and the next move had not begun.
        clocks: what was seen of the host's and the board's.
        rate_hz: samples a second to expect: the plan's, or the one rate that the board has.
    """

    rig: Rig
    control: Control
    recorder: Recorder
    clock_s: float = 0.0
    stream: Stream = field(init=False)
    stage_deg: float | None = None
    stood_at_s: float = 0.0
    rate_hz: float = field(init=False)
    clocks: SeenClocks = field(default_factory=SeenClocks)
    _untold: list[Motion] = field(default_factory=list)
    _stood_deg: float | None = None
    _watched_s: float = 0.0

    def begin(self, plan: Plan, *, moves: bool, mount: Mounting | None = None) -> None:
        """Starts the board, and makes the stage ready where it is to move: homed, at the plan's velocity.

        `mount` is how the unit is clamped; None where a person is asked for that next.
        """
        self.rate_hz = self.rig.board_identity.rate_hz or plan.rate_hz
        kalman = KalmanFilter(KalmanNoise(**self.rig.settings.filter.model_dump()), self.gap_s)
        count = self.recorder.meter.samples
        self.stream = Stream(self.rig.board, kalman, self.clock_s, count, plan.mount_axis)
        self.rig.board.start(plan.rate_hz)
        if moves and self.rig.axis.needs_home():
            self.rig.axis.begin_home()
            self.until_it_stands()
        if moves and mount is not None and not self.rig.stage_identity.homes:
            self._check_gravity(mount)
        if moves and plan.velocity_dps is not None and plan.kind != "sweep":
            self.rig.axis.set_velocity(plan.velocity_dps)  # refused by some before they are referenced
        self._stands(self.rig.axis.elevation_deg())
        self.stood_at_s = self.synchronise()  # what the gyro felt before is homing's, and no pose's move

    def _check_gravity(self, mount: Mounting) -> None:
        """Before anything moves: a stage that cannot home may stand elsewhere than it says."""
        angle_deg, accel_g = self._gravity(mount)
        if not np.isnan(accel_g).any():
            self.rig.place.check_gravity(self.rig.axis.elevation_deg(), angle_deg, mount)

    def why_not(self, mount: Mounting, errors: OwnErrors) -> str | None:
        """Why the unit is not clamped so, by what gravity says from now on; None where it is."""
        angle_deg, accel_g = self._gravity(mount)
        return mount.refusal(self.rig.axis.elevation_deg(), errors.without_deg(angle_deg), accel_g)

    def _gravity(self, mount: Mounting) -> tuple[float, FloatArray]:
        """The angle about the unit's axis, and (3,) the mean specific force, NaN where the board has none."""
        self.forget(self.synchronise())
        self.wait_until(self.stood_at_s + GRAVITY_S)
        seen = self.stream.kept()
        accel_g = seen.samples.accel_g.mean(axis=0)
        if not np.isnan(accel_g).any():
            return angle_about_deg(mount.axis, accel_g), accel_g
        turns = np.exp(1j * np.radians(seen.elevation_deg))
        return float(np.degrees(np.angle(turns.mean()))), accel_g

    def wait_for_mount(self, mount: Mounting, errors: OwnErrors) -> None:
        """Stands until a person has clamped the unit so and says Go, and gravity agrees.

        Readings meanwhile tell at which angle it is clamped.
        """
        self.recorder.waits_for(
            mount.asked,
            lambda stage_deg, reading_deg: mount.clamped_at(stage_deg, errors.without_deg(reading_deg)),
        )
        with self.control.waiting():
            refusal: str | None = "nobody said Go"
            while refusal is not None:
                self.stand_by()
                if (go := self.control.take_go()) is not None:
                    refusal = self._answered(go, mount, errors)

    def _answered(self, go: ResumeRequest, mount: Mounting, errors: OwnErrors) -> str | None:
        """Why the unit is not clamped as it should be; whoever asked is told once the run goes on, or not."""
        refusal: str | None = ENDED
        try:
            refusal = self.why_not(mount, errors)
            if refusal is None:
                self.control.resume()  # whoever wished for a pause meanwhile has had it
                self.recorder.state("running", asked=Act("resumed", go.who))
        finally:
            go.answer(refusal)
        self.forget(self.synchronise())
        return refusal

    @property
    def gap_s(self) -> float:
        """Without a sample for longer than this, it is not known how far the stage has turned."""
        return GAP_PERIODS / self.rate_hz

    def move(self, target_deg: float, seen: Callable[[Motion], None] = lambda _motion: None) -> None:
        """Moves to an elevation and waits until the stage stands there; `seen` is told of each look at it."""
        self._stood_deg = None
        self.rig.place.leaves()
        self.rig.axis.begin_move(target_deg)
        self.until_it_stands(seen)
        if self.stage_deg is not None:
            self.rig.place.stands(self.stage_deg)

    def until_it_stands(self, seen: Callable[[Motion], None] = lambda _motion: None) -> None:
        """Looks until the stage has ended its motion."""
        while True:
            motion = self.rig.axis.poll()
            self.stage_deg = motion.elevation_deg
            if not motion.moving:
                return self._stands(motion.elevation_deg)
            self.look(motion)
            seen(motion)

    def _stands(self, elevation_deg: float) -> None:
        self.stage_deg = self._stood_deg = elevation_deg
        self._watched_s = self.rig.clock.now_s()

    def see_that_it_stands(self) -> None:
        """Looks where the stage stands; StageError where it has left its place without being told to."""
        if self._stood_deg is not None:
            self.stage_deg = self.rig.axis.see_that_it_stands(self._stood_deg)
            self._watched_s = self.rig.clock.now_s()

    def look(self, motion: Motion | None = None) -> None:
        """Takes samples for a moment, tells what is seen, and unwinds where an end was asked for.

        A stage on the move, as of `motion`, is told with the reading of the same instant, once that has come.
        """
        if self.stream.pump(LOOK_S):
            self.clocks.append(self.rig.clock.now_s(), self.stream.clock_s)
        self.control.check()
        if self.rig.clock.now_s() - self._watched_s > WATCH_S:
            self.see_that_it_stands()
        self._tell(motion)

    def _tell(self, motion: Motion | None) -> None:
        at_s, stage_deg, reading_deg = self.stream.clock_s, self.stage_deg, self.stream.reading_deg
        if motion is None or not len(self.clocks.pairs_s) or math.isnan(motion.asked_s[0]):
            self._untold.clear()
        else:
            self._untold.append(motion)
            come = [(then_s, one) for one in self._untold if (then_s := self._board_s(one)) <= at_s]
            if not come:
                return
            (at_s, last), self._untold = come[-1], self._untold[len(come) :]
            stage_deg, reading_deg = last.elevation_deg, self.stream.reading_at(at_s)
        self.recorder.reading(at_s, stage_deg, reading_deg, self.stream.temperature_c)

    def _board_s(self, motion: Motion) -> float:
        """The board's clock at a look at the stage, by the samples that came promptest of late."""
        pairs_s = self.clocks.pairs_s
        (first_s, first_board_s), (now_s, board_s) = pairs_s[[0, -1]].tolist()
        rate = (board_s - first_board_s) / (now_s - first_s) if now_s > first_s else 1.0
        late_s = pairs_s[-LATELY:]
        return float((late_s[:, 1] - rate * late_s[:, 0]).max()) + rate * sum(motion.asked_s) / 2

    def wait_until(self, clock_s: float) -> None:
        """Looks until the board's clock has come so far."""
        while self.stream.clock_s < clock_s:
            self.look()

    def synchronise(self) -> float:
        """The board's clock now: of a sample that was measured after this call.

        However long what was measured before it is held up on its way, the board's own sign comes after it.
        The first block after that may yet have waited in the system, where a board gives no sign.
        """
        self.rig.board.mark()
        while not self.rig.board.marked:
            self.look()
        while self.stream.pump(0.0):
            pass
        for _ in range(2):
            before_s = self.stream.clock_s
            while self.stream.clock_s == before_s:
                self.look()
        return self.stream.clock_s

    def stand_by(self) -> None:
        """Looks while the stage stands for who knows how long, and keeps none of its samples."""
        self.look()
        self.forget(self.stream.clock_s)

    def hold_while_paused(self) -> None:
        """Stands by for as long as a pause is wished."""
        if not self.control.holding:
            return
        self.recorder.state("paused", asked=self.control.paused)
        while self.control.holding:
            self.stand_by()
        self.recorder.state("running", asked=self.control.resumed)

    def forget(self, before_s: float) -> None:
        """Lets go of samples from before a time at which the stage stood and the next move had not begun."""
        self.stood_at_s = before_s
        self.stream.cut(before_s)
