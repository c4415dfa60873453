"""Whether the unit felt what the stage says it did: the gyro over each move, and gravity after it.

An open loop that loses steps tells nobody; the unit on it knows. Both tell a move only as well as they are known,
and before a calibration that is not well: so what may be wrong with unit and stage is learned move by move. Each
move is predicted before it is learned from, and what is left is held against what the prediction allows.

The model of the difference between what is felt and what the stage turned, linear in its parameters (states):

    gyro    = scale·Δ + common
    gravity = harmonics of the unit's own elevation + share of the last moves not settled + common
    common  = gain·Δ + play at reversals + harmonics of the stage's angle

Its recursive least squares are those of a Kalman filter without dynamics (Bar-Shalom, Li, Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, section 3.4), the priors rectangular within what the data sheet
of an uncalibrated MPU-6050 (PS-MPU-6000A, section 6) and an ordinary open-loop stage allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calrig.calibration.pose import Pose
from calrig.estimation.angles import FloatArray, wrap_deg

CHANCE_STD = 6.0
SAID_DEG = 0.3
"""A discrepancy beyond both is said."""
ENDS_DEG = 2.0
"""One beyond this, or two in a row, and the stage's word is worth nothing any more."""
CONTRADICTS_STD = 4.0
"""Gyro and gravity that differ by more cannot both be right: then gravity decides, which sees where the unit is."""

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
"""What the stage does from move to move beyond all that: a worm, a following error. A guess worth four moves."""
GYRO_LINEARITY, GYRO_OWN_DEG, GRAVITY_OWN_DEG = 0.002, 0.02, 0.03
DRIFT_DEG_PER_C, DRIFT_DEG_PER_S = 0.03, 0.0005
"""How far a unit's elevation wanders with temperature, and where that is not known, with time."""
WHOLE_PLAY_DEG = 1.5
"""A shorter move may leave part of the play: which flank the table lies on is not known after it."""

GYRO_BIAS_DPS, GYRO_WANDER_DPS = 0.05, 0.003


@dataclass(frozen=True, slots=True)
class MoveCheck:
    """One move, by the stage's account and by the unit's.

    Attributes:
        stage_deg: what the stage says it turned.
        felt_deg: what the unit felt of it, corrected for what is known of the unit.
        std_deg: standard error of the difference of the two.
        gyro_deg, gravity_deg: the two witnesses of it, likewise corrected; None where there is none.
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
        """What the unit felt, in a sentence's worth."""
        witnesses = [
            f"{name} {value:+.2f}°"
            for name, value in (("gyro", self.gyro_deg), ("gravity", self.gravity_deg))
            if value is not None
        ]
        return (
            f"the stage says that it turned by {self.stage_deg:+.2f}°, and the unit felt {self.felt_deg:+.2f}° "
            f"({', '.join(witnesses)}; standard error {self.std_deg:.2f}°)"
        )


def gyro_move_std_deg(
    time_s: FloatArray, rate_dps: FloatArray, bias_std_dps: float | None, dwell_s: float
) -> float:
    """Standard error of an integrated rate but for the gyro's scale: bias, noise, and steps between samples.

    The bias is the mean of two dwells', each of standard error b, and white noise of that b integrates likewise:
    b²·T·(T/2 + dwell). A rate that changes by Δ from one sample to the next leaves dt·Δ/√12 a step unknown, which
    is what a slow or coarse board does.

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
        """The unit's elevation at the last pose is not to be compared with the next one's."""
        self._gravity_holds = False

    def take(self, now: Pose, turned_deg: float | None, gyro_std_deg: float = 0.0) -> MoveCheck | None:
        """Judges the move into a pose, and learns from it where it agrees.

        Args:
            now: the pose, its `gyro_move_deg` and its reading or accelerometer.
            turned_deg: what the stage says it turned since the pose before, or since it stood before the first.
            gyro_std_deg: as `gyro_move_std_deg` gives it.

        Returns:
            None where there is nothing to compare: the stage tells no angle, or neither gyro nor gravity tell.
        """
        last, self._last = self._last, now
        if turned_deg is None:
            self._gravity_holds, self._flank_known = True, False
            return None
        rows, felt_deg, own = self._witnesses(last, now, turned_deg, gyro_std_deg)
        flank_known = self._note_flank(last, now, turned_deg)
        self._gravity_holds, self._last_turn_deg = True, turned_deg
        if not rows:
            return None
        names, design, values = list(rows), np.array(list(rows.values())), np.array(list(felt_deg.values()))
        common = self._irregular[1] / self._irregular[0]
        if not flank_known:
            common += float(self._mean[PLAY] ** 2 + self._covariance[PLAY, PLAY])
        noise = np.diag(list(own.values())) + common
        left = values - design @ self._mean
        innovation = design @ self._covariance @ design.T + noise
        used = _consistent(names, left, innovation)
        left_used, innovation_used = left[used], innovation[np.ix_(used, used)]
        weights = np.linalg.solve(innovation_used, np.ones(len(used)))
        variance = 1.0 / float(weights.sum())
        difference_deg = variance * float(weights @ left_used)
        verdict = self._verdict(difference_deg, math.sqrt(variance))
        if verdict == "agrees":
            self._learn(design[used], left_used, innovation_used)
            self._learn_irregularity(difference_deg, variance, flank_known=flank_known)
        told = {name: turned_deg + float(left[k]) for k, name in enumerate(names)}
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
    ) -> tuple[dict[str, FloatArray], dict[str, float], dict[str, float]]:
        """By name: the row of the design, the angle felt less the stage's, the variance of its own."""
        rows: dict[str, FloatArray] = {}
        felt: dict[str, float] = {}
        own: dict[str, float] = {}
        common = self._common_row(last, now, turned_deg)
        if now.gyro_move_deg is not None:
            rows["gyro"] = common.copy()
            rows["gyro"][GYRO_SCALE] = turned_deg
            felt["gyro"] = now.gyro_move_deg - turned_deg
            own["gyro"] = GYRO_OWN_DEG**2 + (GYRO_LINEARITY * turned_deg) ** 2 + gyro_std_deg**2
        if last is not None and self._gravity_holds:
            before_deg, after_deg = gravity_deg(last), gravity_deg(now)
            rows["gravity"] = common.copy()
            rows["gravity"][UNIT] = _unit_shape(after_deg) - _unit_shape(before_deg)
            settling = turned_deg - self._last_turn_deg
            rows["gravity"][SETTLING] = settling
            felt["gravity"] = wrap_deg(after_deg - before_deg - turned_deg)
            own["gravity"] = _gravity_variance(last, now)
            if now.accel_y_g is None:
                own["gravity"] += 2 * GRAVITY_OWN_DEG**2
                own["gravity"] += (UNSETTLED_ANGLE * settling / self._trust()) ** 2
        return rows, felt, own

    def _trust(self) -> float:
        """How many moves have gone well, as a share of what the irregularity is learned from; 1 at first."""
        return math.sqrt(self._irregular[0] / IRREGULAR_MOVES)

    def _common_row(self, last: Pose | None, now: Pose, turned_deg: float) -> FloatArray:
        row = np.zeros(len(PRIOR_STD))
        row[GAIN] = turned_deg
        row[STAGE] = _stage_shape(now.theta_deg) - _stage_shape(now.theta_deg - turned_deg)
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

    def _learn_irregularity(self, difference_deg: float, variance: float, *, flank_known: bool) -> None:
        """One step of expectation and maximisation: the share of the difference that is the stage's own."""
        if not flank_known:
            return
        prior = self._irregular[1] / self._irregular[0]
        share = prior / variance
        self._irregular[0] += 1.0
        self._irregular[1] += (share * difference_deg) ** 2 + prior * (1.0 - share)


def gravity_deg(pose: Pose) -> float:
    """Elevation by gravity alone where the pose has an accelerometer, else by the reading."""
    if pose.accel_y_g is None or pose.accel_z_g is None:
        return pose.reading_deg
    return math.degrees(math.atan2(pose.accel_y_g, pose.accel_z_g))


def _gravity_variance(last: Pose, now: Pose) -> float:
    """Of the difference of two poses' gravity: noise, and what drifts between them."""
    noise = (last.reading_stderr_deg or 0.0) ** 2 + (now.reading_stderr_deg or 0.0) ** 2
    warmed_c = (
        0.0
        if last.temperature_c is None or now.temperature_c is None
        else now.temperature_c - last.temperature_c
    )
    passed_s = 0.0 if last.time_s is None or now.time_s is None else now.time_s - last.time_s
    drift = (DRIFT_DEG_PER_C * warmed_c) ** 2 + (DRIFT_DEG_PER_S * passed_s) ** 2
    return noise + GRAVITY_OWN_DEG**2 + drift


def _stage_shape(stage_deg: float) -> FloatArray:
    angle = math.radians(stage_deg)
    return np.array([math.sin(angle), math.cos(angle), math.sin(2 * angle), math.cos(2 * angle)])


def _unit_shape(elevation_deg: float) -> FloatArray:
    """Offsets of y and z turn the elevation by cos and −sin; skew and gain by cos² and sin 2θ/2; and the third."""
    angle = math.radians(elevation_deg)
    s, c = math.sin(angle), math.cos(angle)
    return np.array([c, -s, c * c, s * c, math.sin(3 * angle), math.cos(3 * angle)])


def _consistent(names: list[str], left: FloatArray, innovation: FloatArray) -> list[int]:
    """Indices of the witnesses that decide: all, or gravity alone where the gyro contradicts it."""
    if len(names) < 2:
        return [0]
    apart = float(left[1] - left[0])
    std = math.sqrt(float(innovation[0, 0] + innovation[1, 1] - 2 * innovation[0, 1]))
    return [0, 1] if abs(apart) <= CONTRADICTS_STD * std else [1]
