"""One pass of a sweep as it was seen, and the poses that its stretches and the dwell at its end make."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calrig.calibration.motor_vibration import UnreportedTurn
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
    even_turn,
    filter_lag_deg,
    gyro_turn,
    hidden_dps,
    turn_between,
    turned_back,
)
from calrig.instruments.axis import Motion
from calrig.instruments.types import Samples
from calrig.plan import PlannedPose
from calrig.runs.pose_taking import pose_of
from calrig.runs.stream import Stretch

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

    def felt_as(self, gyro_move_deg: float | None) -> Pose:
        """The pose with the move into it by the gyro."""
        return replace(self.pose, gyro_move_deg=gyro_move_deg)


@dataclass(frozen=True, slots=True)
class TurnedPass:
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

    kept: Stretch
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

        Args:
            last: of the stretches.
            felt: the gyro's gain, and the delay.
            bias_std_dps: of `bias_dps`.
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

        Args:
            planned: the stretches and the dwell.
            reading: of the dwell.
            felt: the gyro's gain, what the filter shows of which is taken off, and the delay.
            settle_s: before the dwell.
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
