"""Compare each move as the unit measured it with the rotation that the stage reports, pose by pose.

An open-loop stage that loses steps does not report it; gyro and gravity measure it. Before a calibration the
errors of unit and stage are not known, so they are learned move by move: each move is predicted first, and
the residual is compared with the uncertainty of the prediction.

The measured rotation minus the reported one (Δ) is linear in unknown errors of the unit and the stage:

    gyro    = scale·Δ + common
    gravity = harmonics of the unit's own elevation + a share of the last moves not settled yet + common
    common  = gain·Δ + play at reversals + harmonics of the stage's angle

by recursive least squares (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 3.4), from rectangular priors of what an uncalibrated MPU-6050 (PS-MPU-6000A,
section 6) and an ordinary open-loop stage may have.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calrig.calibration.poses import Pose
from calrig.estimation.angles import FloatArray, wrap_deg

CHANCE_STD = 6.0
SAID_DEG = 0.3
"""A discrepancy beyond both is reported as a mismatch."""
ENDS_DEG = 2.0
"""A discrepancy beyond this, or two in a row, ends the run: the stage's position is lost."""
CONTRADICTS_STD = 4.0
"""Where gyro and gravity differ by more, one is wrong; gravity decides, since it measures the elevation."""

RECTANGULAR = 1.0 / math.sqrt(3.0)
PRIOR_STD = RECTANGULAR * np.array(
    [
        0.03,  # the gyro's scale: ±3 %
        0.015,  # the stage's own gain, steps a degree
        0.75,  # play, degrees
        *[0.9, 0.9, 0.4, 0.4],  # the stage's first and second harmonic, degrees
        *np.degrees(
            [0.050, 0.080, 0.02, 0.03]
        ),  # offsets of y and z: 50 and 80 mg; cross-axis 2 %; gains 3 %
        *[0.3, 0.3],  # third harmonic of the unit: its nonlinearity, 0.5 %
        0.03,  # share of a move that is not settled when the dwell begins
    ]
)
GYRO_SCALE, GAIN, PLAY, STAGE, UNIT, SETTLING = 0, 1, 2, slice(3, 7), slice(7, 13), 13
UNSETTLED_ANGLE = RECTANGULAR * 0.1
"""Of a board that sends an angle it has filtered itself."""

IRREGULAR_DEG = 0.1
IRREGULAR_MOVES = 4.0
"""What the stage does beyond all that, such as a worm: a guess that weighs as much as four moves."""
GYRO_LINEARITY, GYRO_OWN_DEG, GRAVITY_OWN_DEG = 0.002, 0.02, 0.03
DRIFT_DEG_PER_C, DRIFT_DEG_PER_S = 0.03, 0.0005
"""How far a unit's elevation wanders with temperature, and where that is not known, with time."""
STILL_DEG = 0.02
"""A stage that reports a smaller rotation did not turn: the digits of its report, or less than a step."""
RELAXED_DEG = 0.04
"""How far a table turns by itself while its stage stands: what relaxes, or creeps."""
LEARNED_STD = 2.0
"""A discrepancy beyond so many standard errors counts as one of this size for the irregularity, and as so
much noisier for the rest: an undetected slip hardly widens the tolerance of later moves (Huber, Robust
Statistics, 1981, section 7.8)."""
WHOLE_PLAY_DEG = 1.5
"""A shorter move may leave part of the play: which flank the table lies on is not known after it."""

GYRO_BIAS_DPS, GYRO_WANDER_DPS = 0.05, 0.003
"""How well a gyro's bias is known where its dwell does not tell, and how far it wanders within a move."""


@dataclass(frozen=True, slots=True)
class MoveCheck:
    """One move, by the stage's account and by the unit's.

    Attributes:
        stage_deg: what the stage says it turned.
        felt_deg: what the unit felt of it, corrected for what is known of unit and stage.
        std_deg: standard error of their difference.
        gyro_deg, gravity_deg: the two witnesses, likewise; None where there is none.
        verdict: `agrees`; `mismatch`, beyond chance; `lost`, by so much, or so often, that a run must end.
    """

    stage_deg: float
    felt_deg: float
    std_deg: float
    gyro_deg: float | None
    gravity_deg: float | None
    verdict: Literal["agrees", "mismatch", "lost"]

    @property
    def difference_deg(self) -> float:
        """What the unit felt less what the stage says."""
        return self.felt_deg - self.stage_deg

    def words(self) -> str:
        """Return what the unit felt, in a sentence's worth."""
        witnesses = [
            f"{name} {value:+.2f}°"
            for name, value in (("gyro", self.gyro_deg), ("gravity", self.gravity_deg))
            if value is not None
        ]
        return (
            f"the stage says that it turned by {self.stage_deg:+.2f}°, and the unit felt "
            f"{self.felt_deg:+.2f}° ({', '.join(witnesses)}; standard error {self.std_deg:.2f}°)"
        )


def gyro_move_std_deg(
    time_s: FloatArray, rate_dps: FloatArray, bias_std_dps: float | None, dwell_s: float
) -> float:
    """Standard error of an integrated rate but for the gyro's scale: bias, noise, and steps between samples.

    The bias is the mean of two dwells', each of standard error b; with the white noise that gives such a b,
    the integral over T has the variance b²·T·(T/2 + dwell). A rate that changes by Δ from one sample to the
    next leaves dt·Δ/√12 of that step unknown: so much for a slow or a coarse board.

    Args:
        time_s: (n,) of the move's samples.
        rate_dps: (n,) about the stage's axis.
        bias_std_dps: of one dwell; None where not known.
        dwell_s: how long that dwell was.
    """
    if len(time_s) < 2:
        return 0.0
    steps_s = np.diff(time_s)
    turn_s = float(time_s[-1] - time_s[0])
    steps_deg = steps_s * np.diff(rate_dps)
    known = GYRO_BIAS_DPS if bias_std_dps is None else bias_std_dps
    variance = known**2 * turn_s * (turn_s / 2 + dwell_s) + (GYRO_WANDER_DPS * turn_s) ** 2
    return math.sqrt(variance + float(steps_deg @ steps_deg) / 12)


class _Witness(NamedTuple):
    """What one channel says: its row of the design, angle felt less the stage's, own variance in deg²."""

    name: str
    row: FloatArray
    less_stage_deg: float
    variance: float


class MoveWatch:
    """Judges each move of a run in its order, by what it has learned from those before."""

    def __init__(self) -> None:
        self._mean = np.zeros(len(PRIOR_STD))
        self._covariance = np.diag(PRIOR_STD**2)
        self._irregular = [IRREGULAR_MOVES, IRREGULAR_MOVES * IRREGULAR_DEG**2]
        self._last: Pose | None = None
        self._last_turn_deg = 0.0
        self._gravity_holds = False
        self._flank_known = False
        self._in_a_row = 0

    def touched(self) -> None:
        """Return the unit's elevation at the last pose is not to be compared with the next one's."""
        self._gravity_holds = False

    def take(self, now: Pose, turned_deg: float | None, gyro_std_deg: float = 0.0) -> MoveCheck | None:
        """Judge the move into a pose, and learn from it if it agrees.

        Args:
            now: the pose, its `gyro_move_deg` and its reading or accelerometer.
            turned_deg: what the stage says it turned since the pose before, or the run's begin.
            gyro_std_deg: as `gyro_move_std_deg` gives it.

        Returns:
            None where there is nothing to compare: the stage tells no angle, or the unit no move.
        """
        last, self._last = self._last, now
        if last is None and now.accel_y_g is None:
            self._covariance[SETTLING, SETTLING] = UNSETTLED_ANGLE**2
        if turned_deg is None:
            self._gravity_holds, self._flank_known = True, False
            return None
        witnesses = self._witnesses(last, now, turned_deg, gyro_std_deg)
        still = _stood_still(last, now, turned_deg)
        flank_known = still or self._note_flank(last, now, turned_deg)
        self._gravity_holds, self._last_turn_deg = True, turned_deg
        if not witnesses:
            return None
        common = RELAXED_DEG**2 if still else self._irregular[1] / self._irregular[0]
        if not flank_known:
            common += float(self._mean[PLAY] ** 2 + self._covariance[PLAY, PLAY])
        design = np.array([witness.row for witness in witnesses])
        left = np.array([witness.less_stage_deg for witness in witnesses]) - design @ self._mean
        noise = np.diag([witness.variance for witness in witnesses]) + common
        innovation = design @ self._covariance @ design.T + noise
        used = _consistent(left, innovation)
        left_used, innovation_used = left[used], innovation[np.ix_(used, used)]
        weights = np.linalg.solve(innovation_used, np.ones(len(used)))
        variance = 1.0 / float(weights.sum())
        difference_deg = variance * float(weights @ left_used)
        verdict = self._verdict(difference_deg, math.sqrt(variance))
        if verdict == "agrees":
            excess = max(1.0, abs(difference_deg) / (LEARNED_STD * math.sqrt(variance)))
            self._learn(design[used], left_used, excess**2 * innovation_used)
            if flank_known and not still:
                self._learn_irregularity(difference_deg / excess, variance)
        told = {witness.name: turned_deg + float(left[k]) for k, witness in enumerate(witnesses)}
        return MoveCheck(
            turned_deg,
            turned_deg + difference_deg,
            math.sqrt(variance),
            told.get("gyro"),
            told.get("gravity"),
            verdict,
        )

    def _witnesses(
        self, last: Pose | None, now: Pose, turned_deg: float, gyro_std_deg: float
    ) -> list[_Witness]:
        found = []
        common = self._common_row(last, now, turned_deg)
        if now.gyro_move_deg is not None:
            row = common.copy()
            row[GYRO_SCALE] = turned_deg
            variance = GYRO_OWN_DEG**2 + (GYRO_LINEARITY * turned_deg) ** 2 + gyro_std_deg**2
            found.append(_Witness("gyro", row, now.gyro_move_deg - turned_deg, variance))
        if last is not None and self._gravity_holds:
            before_deg, after_deg = gravity_deg(last), gravity_deg(now)
            row = common.copy()
            row[UNIT] = _unit_shape(after_deg) - _unit_shape(before_deg)
            row[SETTLING] = turned_deg - self._last_turn_deg
            less_stage_deg = wrap_deg(after_deg - before_deg - turned_deg)
            found.append(_Witness("gravity", row, less_stage_deg, _gravity_variance(last, now)))
        return found

    def _common_row(self, last: Pose | None, now: Pose, turned_deg: float) -> FloatArray:
        row = np.zeros(len(PRIOR_STD))
        row[GAIN] = turned_deg
        row[STAGE] = _stage_shape(now.dial_deg) - _stage_shape(now.dial_deg - turned_deg)
        if last is not None:
            row[PLAY] = ((now.approach or 0) - (last.approach or 0)) / 2
        return row

    def _note_flank(self, last: Pose | None, now: Pose, turned_deg: float) -> bool:
        """Whether it is known on which flank of the play the table lay before this move and lies after it."""
        before = self._flank_known and last is not None and bool(last.approach)
        self._flank_known = bool(now.approach) and abs(turned_deg) >= WHOLE_PLAY_DEG
        return before and self._flank_known

    def _verdict(self, difference_deg: float, std_deg: float) -> Literal["agrees", "mismatch", "lost"]:
        if abs(difference_deg) <= max(CHANCE_STD * std_deg, SAID_DEG):
            self._in_a_row = 0
            return "agrees"
        self._in_a_row += 1
        return "lost" if abs(difference_deg) > ENDS_DEG or self._in_a_row > 1 else "mismatch"

    def _learn(self, design: FloatArray, left: FloatArray, innovation: FloatArray) -> None:
        gain = np.linalg.solve(innovation, design @ self._covariance).T
        self._mean = self._mean + gain @ left
        covariance = self._covariance - gain @ innovation @ gain.T
        self._covariance = (covariance + covariance.T) / 2

    def _learn_irregularity(self, difference_deg: float, variance: float) -> None:
        """One step of expectation and maximisation: the share of the difference that is the stage's own."""
        prior = self._irregular[1] / self._irregular[0]
        share = prior / variance
        self._irregular[0] += 1.0
        self._irregular[1] += (share * difference_deg) ** 2 + prior * (1.0 - share)


def _stood_still(last: Pose | None, now: Pose, turned_deg: float) -> bool:
    """Return whether the stage did not turn, so that neither its play nor its gear can explain a rotation."""
    if last is None or abs(turned_deg) > STILL_DEG:
        return False
    return (last.approach or 0) == (now.approach or 0)


def gravity_deg(pose: Pose) -> float:
    """Return elevation by gravity alone where the pose has an accelerometer, else by the reading."""
    if pose.accel_y_g is None or pose.accel_z_g is None:
        return pose.reading_deg
    return math.degrees(math.atan2(pose.accel_y_g, pose.accel_z_g))


def _gravity_variance(last: Pose, now: Pose) -> float:
    """Of the difference of two poses' gravity: noise, and what drifts between them."""
    noise = (last.reading_stderr_deg or 0.0) ** 2 + (now.reading_stderr_deg or 0.0) ** 2
    warmed_c = _less(now.temperature_c, last.temperature_c)
    passed_s = _less(now.time_s, last.time_s)
    drift = (DRIFT_DEG_PER_C * warmed_c) ** 2 + (DRIFT_DEG_PER_S * passed_s) ** 2
    return noise + GRAVITY_OWN_DEG**2 + drift


def _less(now: float | None, before: float | None) -> float:
    return 0.0 if now is None or before is None else now - before


def _stage_shape(stage_deg: float) -> FloatArray:
    angle = math.radians(stage_deg)
    return np.array([math.sin(angle), math.cos(angle), math.sin(2 * angle), math.cos(2 * angle)])


def _unit_shape(elevation_deg: float) -> FloatArray:
    """What y's and z's offset, y's skew and gain, and a nonlinearity add to the elevation, each of size 1."""
    angle = math.radians(elevation_deg)
    s, c = math.sin(angle), math.cos(angle)
    return np.array([c, -s, c * c, s * c, math.sin(3 * angle), math.cos(3 * angle)])


def _consistent(left: FloatArray, innovation: FloatArray) -> list[int]:
    """Return indices of the witnesses that decide: all, or gravity alone where the gyro contradicts it."""
    if len(left) < 2:
        return [0]
    apart = float(left[1] - left[0])
    std = math.sqrt(float(innovation[0, 0] + innovation[1, 1] - 2 * innovation[0, 1]))
    return [0, 1] if abs(apart) <= CONTRADICTS_STD * std else [1]
