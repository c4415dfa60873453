"""Derive from the columns of poses how the stage moved between and during them.

The order of rows is a history only where a column says so: a table sorted by angle was not measured as a
sweep, and the step across ±180° in it is no move. A table that its motor drives with a backlash h stands
still until the motor has come by h (play operator: Visintin, Differential Models of Hysteresis, 1994, section
III.2). A segment of a continuous sweep is the mean over its travel L: a wave of period P keeps the share
sin(πL/P)/(πL/P) of its amplitude, while the gyro measures from middle to middle and keeps the whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.calibration.poses import Filtering, Pose, column_of
from calrig.estimation.angles import BoolArray, FloatArray, wrap_deg
from calrig.estimation.gains import steady_state_gain
from calrig.estimation.gyro import gyro_scale
from calrig.estimation.kalman import KalmanNoise

HISTORY = ("time_s", "sweep", "approach", "gyro_move_deg")
"""Any of these says that rows follow one another as they were measured."""
STANDING = ("reading_std_deg", "reading_stderr_deg", "n_samples", "settle_s", "gyro_move_deg", "filtering")
"""Any of these says that a pose is a dwell."""
DERIVED_APPROACH = (
    "no column tells the approach: the sense of each move was taken from the angles in the order of the rows"
)
TURN_DEG = 360.0
FEWEST = 4
AT_A_POSE = 1e-2
"""Share of an interval, within which a change is taken to have happened at the pose."""
ABRUPT = 0.2
"""Of the largest velocity: a change that no smooth motion makes between two readings."""
SMOOTH = 0.1
"""Of an abrupt change, how much the velocity may change in the two intervals beside it."""
SHORTEST_LAG_S = 1e-6
SHORTEST_STOP_S = 2.0
"""Between poses, to move on, settle and take a mean: readings that follow faster were taken on the move."""
AT_REST = 0.05
"""Of the longest step between readings: shorter ones are no motion."""
NO_STEP = 0.02
"""Of the median step from pose to pose: shorter ones are what a stage at rest reports, and no move."""
MOST_REVERSALS = 0.25
"""To a reading of a log taken on the move: a stroke has several of them."""
ODD_SPEEDS, SAME_SPEED = 0.1, 0.05
"""Share of the readings at either end that may have another speed; of it, how far all others are alike."""


def has_history(poses: Sequence[Pose]) -> bool:
    """Return whether a column tells that the poses come in the order measured."""
    return any(_tells(pose, HISTORY) for pose in poses)


def is_sorted(poses: Sequence[Pose]) -> bool:
    """Whether the order of the rows is that of their elevations, and nothing says that it is a history too.

    Readings that differ from row to row by little then are an error of the angle, not noise that wanders.
    """
    steps = _steps_deg(poses)[1:]
    return not has_history(poses) and bool((steps >= 0.0).all() or (steps <= 0.0).all()) and bool(steps.any())


def moves_deg(poses: Sequence[Pose]) -> FloatArray:
    """Return (n,) move into each pose of a run, degrees; NaN where there is none that is known.

    That is the first pose, all of a table without history, and all of a log taken on the move, whose readings
    follow on no move that had ended.
    """
    if not has_history(poses) or _taken_on_the_move(poses):
        return np.full(len(poses), np.nan)
    return _steps_deg(poses)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where the stage was in a run, between its readings too: cubics of time, without jumps of the angle.

    Attributes:
        time_s: (k + 1,) knots: the readings, and abrupt changes of the velocity between them.
        theta_deg: (k + 1,) there, unwrapped.
        from_dps, to_dps: (k,) velocity at the begin and at the end of each interval.
    """

    time_s: FloatArray
    theta_deg: FloatArray
    from_dps: FloatArray
    to_dps: FloatArray

    def at_deg(self, time_s: FloatArray) -> FloatArray:
        """Return elevations at times of any shape; beyond the first and last knot the stage moves evenly."""
        k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.from_dps) - 1)
        length_s, way_deg = np.diff(self.time_s)[k], np.diff(self.theta_deg)[k]
        share = (time_s - self.time_s[k]) / length_s
        u = np.clip(share, 0.0, 1.0)
        bend = (1.0 - u) * (self.from_dps[k] * length_s - way_deg)
        bend = u * (1.0 - u) * (bend - u * (self.to_dps[k] * length_s - way_deg))
        beyond_deg = (share - u) * length_s * np.where(share < 0.0, self.from_dps[0], self.to_dps[-1])
        return np.asarray(self.theta_deg[k] + u * way_deg + bend + beyond_deg, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the stage moved while n readings were taken.

    Attributes:
        velocity_dps: (n,) at the time of each, deg/s.
        time_s: (n,) of each, on its run's clock.
        run: (n,) index into `paths` of the run that each reading is of.
        paths: of the runs; None where only the velocities are known.
    """

    velocity_dps: FloatArray
    time_s: FloatArray
    run: npt.NDArray[np.intp]
    paths: tuple[Path | None, ...]

    @property
    def has_paths(self) -> bool:
        """Return whether it is known where the stage was between the readings."""
        return None not in self.paths

    @property
    def has_one_speed(self) -> bool:
        """Return whether nearly all readings were taken at the same speed, forward or backward."""
        slow_dps, fast_dps = np.quantile(np.abs(self.velocity_dps), (ODD_SPEEDS, 1.0 - ODD_SPEEDS))
        return bool(fast_dps - slow_dps <= SAME_SPEED * fast_dps)

    def travelled_deg(self, lag_s: float) -> FloatArray:
        """Return (n,) travel over a time before each reading; below 0: minus that over a time after it."""
        travelled = lag_s * self.velocity_dps
        for k, path in enumerate(self.paths):
            if path is not None:
                own = self.run == k
                now, before = np.split(path.at_deg(np.add.outer([0.0, -lag_s], self.time_s[own])), 2)
                travelled[own] = (now - before)[0]
        return np.asarray(travelled, dtype=np.float64)

    def mean_dps(self, lag_s: float) -> FloatArray:
        """Return (n,) mean velocity over a time before each reading; after it where `lag_s` is below 0."""
        lag_s = lag_s if abs(lag_s) > SHORTEST_LAG_S else SHORTEST_LAG_S
        return self.travelled_deg(lag_s) / lag_s

    def rows(self, chosen: npt.NDArray[np.intp]) -> Motion:
        """Return the same of some of the readings."""
        return Motion(self.velocity_dps[chosen], self.time_s[chosen], self.run[chosen], self.paths)


def joined(motions: Sequence[Motion | None]) -> Motion | None:
    """Return the motion of several runs, of one path each; None where it is not known of one."""
    known = [motion for motion in motions if motion is not None]
    if len(known) < len(motions):
        return None
    return Motion(
        np.concatenate([motion.velocity_dps for motion in known]),
        np.concatenate([motion.time_s for motion in known]),
        np.repeat(np.arange(len(known)), [len(motion.run) for motion in known]),
        tuple(path for motion in known for path in motion.paths),
    )


def motion_of(poses: Sequence[Pose]) -> Motion | None:
    """How the stage moved at a run's poses: as `velocity_dps` has it, else derived; None where not known.

    A log taken on the move tells it by its times and elevations: central differences, and next to a reversal
    the stroke that the pose is part of. Poses that stood have none, whatever lies between them.
    """
    derived = _derived(poses) if _taken_on_the_move(poses) else None
    given = [pose.covariates.get("velocity_dps") for pose in poses]
    known = [velocity for velocity in given if velocity is not None]
    if not known or len(known) < len(given):
        return derived
    run = np.zeros(len(known), dtype=np.intp)
    return Motion(np.array(known, dtype=np.float64), np.zeros(len(known)), run, (None,))


def approach_of(poses: Sequence[Pose]) -> FloatArray | None:
    """(n,) sense of the move to each pose of a run: as given, else that of the motion it was taken in."""
    given = column_of(poses, "approach")
    if given is None and _taken_on_the_move(poses):
        before = np.sign(np.nan_to_num(_steps_deg(poses)))
        goes_on = before * np.append(before[1:], 0.0) > 0.0  # whatever a smooth motion would do there
        return np.where(goes_on, before, np.sign(_derived(poses).mean_dps(SHORTEST_LAG_S)))
    return given


def with_approach(runs: Sequence[Sequence[Pose]]) -> tuple[list[list[Pose]], bool]:
    """Return runs whose poses tell the sense of their last move, and whether steps had to tell it.

    A stage that stops at each pose, in an order that is known, came from the pose before.
    """
    found, is_derived = [], False
    for run in runs:
        if column_of(run, "approach") is not None or not has_history(run) or _taken_on_the_move(run):
            found.append(list(run))
            continue
        senses = _senses(_steps_deg(run))
        is_derived |= bool(np.ptp(senses) > 0.0)
        found.append([replace(pose, approach=int(k)) for pose, k in zip(run, senses, strict=True)])
    return found, is_derived


def _senses(step_deg: FloatArray) -> FloatArray:
    """Return (n,) sign of the last step that moved the stage; 0 before the first."""
    size_deg = np.abs(np.nan_to_num(step_deg))
    steps_deg = size_deg[size_deg > 0.0]
    moved = size_deg > (NO_STEP * np.median(steps_deg) if len(steps_deg) else 0.0)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(step_deg)), 0))
    return np.asarray(np.where(moved[last], np.sign(step_deg[last]), 0.0), dtype=np.float64)


def _derived(poses: Sequence[Pose]) -> Motion:
    times_s = _times_s(poses)
    gap_s, way_deg = np.diff(times_s), _steps_deg(poses)[1:]
    pace = way_deg / gap_s
    share, from_dps = _abrupt(pace)
    before, after = np.append(pace[:1], pace), np.append(pace, pace[-1:])
    # the mean velocity of an interval in which the motion changed is that of neither of its poses
    turned, turning = np.append(False, share < 1.0), np.append(share > 0.0, False)
    at_change = np.append(False, share == 1.0) | np.append(share == 0.0, False)
    steady = at_change | np.append(at_change[1:], False)
    known = np.select([turned & ~turning, turning & ~turned, steady], [after, before, before], np.nan)
    velocity = _smooth_dps(gap_s, pace, known)
    theta_deg = np.cumsum(np.append(0.0, way_deg))
    begin_dps = np.where(share == 0.0, pace, velocity[:-1])
    end_dps = np.where(share == 1.0, pace, velocity[1:])
    begin_dps[1:][share[:-1] == 1.0] = pace[1:][share[:-1] == 1.0]
    end_dps[:-1][share[1:] == 0.0] = pace[:-1][share[1:] == 0.0]
    inside = np.flatnonzero((share > 0.0) & (share < 1.0))
    begin_dps[inside] = end_dps[inside] = from_dps[inside]
    to_s = share[inside] * gap_s[inside]
    rest_dps = (way_deg[inside] - from_dps[inside] * to_s) / (gap_s[inside] - to_s)
    path = Path(
        np.insert(times_s, inside + 1, times_s[inside] + to_s),
        np.insert(theta_deg, inside + 1, theta_deg[inside] + from_dps[inside] * to_s),
        np.insert(begin_dps, inside + 1, rest_dps),
        np.insert(end_dps, inside + 1, rest_dps),
    )
    return Motion(velocity, times_s, np.zeros(len(poses), dtype=np.intp), (path,))


def _smooth_dps(gap_s: FloatArray, pace: FloatArray, known_dps: FloatArray) -> FloatArray:
    """Return (n,) velocities of the cubic spline through n poses; its acceleration is continuous.

    Args:
        gap_s: (n − 1,) times between the poses.
        pace: (n − 1,) mean velocities there.
        known_dps: (n,) velocities of poses next to an abrupt change of the motion; NaN of the others.
    """
    # (de Boor, A Practical Guide to Splines, 1978, chapter IV, equation 10; ends without acceleration)
    before, after = np.append(0.0, 1.0 / gap_s), np.append(1.0 / gap_s, 0.0)
    diagonal = 2.0 * (before + after)
    right = 3.0 * (np.append(0.0, pace / gap_s) + np.append(pace / gap_s, 0.0))
    free = np.isnan(known_dps)
    before, after = before * free, after * free
    diagonal, right = np.where(free, diagonal, 1.0), np.where(free, right, known_dps)
    for k in range(1, len(right)):  # Thomas' elimination of a system of three diagonals
        share = before[k] / diagonal[k - 1]
        diagonal[k] -= share * after[k - 1]
        right[k] -= share * right[k - 1]
    velocity = right / diagonal
    for k in range(len(right) - 2, -1, -1):
        velocity[k] = (right[k] - after[k] * velocity[k + 1]) / diagonal[k]
    return velocity


def _abrupt(pace: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return after which share of each interval the motion changed abruptly, and the velocity before.

    That is where the strokes before and after an interval meet within it: 0 at its first pose, 1 at its last;
    NaN where the motion did not change.

    `pace` are (n − 1,) mean velocities between n poses, deg/s.
    """
    from_dps, to_dps = pace[:-2], pace[2:]
    jump = from_dps - to_dps
    # a motion that changes smoothly changes as much before and after the interval
    change = np.abs(np.pad(np.diff(pace), 1, mode="edge"))
    beside = change[:-3] + change[3:]
    is_jump = (np.abs(jump) > ABRUPT * np.abs(pace).max()) & (beside < SMOOTH * np.abs(jump))
    share = np.divide(pace[1:-1] - to_dps, jump, out=np.full(len(jump), -1.0), where=is_jump)
    within = (share > AT_A_POSE) & (share < 1.0 - AT_A_POSE)
    # beside an interval with a change in it, its mean looks like a change at the pose between
    at_end = (np.abs(share - 1.0) <= AT_A_POSE) & ~np.append(within[1:], False)
    at_start = (np.abs(share) <= AT_A_POSE) & ~np.append(False, within[:-1])
    share = np.select([within, at_end, at_start], [share, 1.0, 0.0], np.nan)
    return np.pad(share, 1, constant_values=np.nan), np.pad(from_dps, 1)


def _taken_on_the_move(poses: Sequence[Pose]) -> bool:
    """Whether readings follow faster than a stage could stop for them, and nothing says that it did.

    A stage that goes to and fro from reading to reading stops for each of them, however fast they follow.
    """
    if len(poses) < FEWEST or any(_tells(pose, STANDING) or pose.time_s is None for pose in poses):
        return False
    since_s, steps_deg = np.diff(_times_s(poses)), _steps_deg(poses)[1:]
    sense = np.sign(steps_deg) * (np.abs(steps_deg) > AT_REST * np.abs(steps_deg).max())
    reversals = int((sense[1:] * sense[:-1] < 0.0).sum())
    return bool(
        (since_s > 0.0).all()
        and np.median(since_s) < SHORTEST_STOP_S
        and reversals <= MOST_REVERSALS * len(poses)
    )


def _times_s(poses: Sequence[Pose]) -> FloatArray:
    return np.array([pose.time_s for pose in poses], dtype=np.float64)


def _steps_deg(poses: Sequence[Pose]) -> FloatArray:
    """Return (n,) elevation less that of the pose before, NaN for the first.

    Where all elevations lie within one turn, a step of more than half of it went the short way round, unless
    the sense of the move says that it went the long one.
    """
    theta = np.array([pose.theta_deg for pose in poses], dtype=np.float64)
    step = np.diff(theta, prepend=np.nan)
    if np.ptp(theta) > TURN_DEG:
        return step  # counted over turns, as an axis without an end has it
    sense = np.array([pose.approach or 0 for pose in poses])
    short = (np.abs(step) > TURN_DEG / 2.0) & (sense != np.sign(step))
    return np.where(short, wrap_deg(step), step)


def _tells(pose: Pose, columns: Sequence[str]) -> bool:
    return any(getattr(pose, name) is not None for name in columns)


def travel_deg(move_deg: FloatArray, approach: FloatArray | None, starts: BoolArray) -> FloatArray:
    """Return (n,) way in one sense since the stage last turned; infinite where nothing says that it is short.

    Args:
        move_deg: (n,) into each pose; 0 or NaN where it is not known.
        approach: (n,) its sense; a pose come to from beyond has the other one, and all play taken up.
        starts: (n,) whether a pose follows on nothing.
    """
    travel = np.full(len(move_deg), np.inf)
    if approach is None:
        return travel
    for k in range(1, len(travel)):
        if starts[k] or not approach[k] * move_deg[k] > 0.0:
            continue
        before = travel[k - 1] if approach[k] == approach[k - 1] else 0.0
        travel[k] = before + abs(move_deg[k])
    return travel


def slack_deg(play_deg: float, travelled_deg: FloatArray) -> FloatArray:
    """Return (n,) what is left of a play, after some way."""
    return np.maximum(abs(play_deg) - travelled_deg, 0.0)


def stretches_deg(poses: Sequence[Pose]) -> FloatArray:
    """Return (n,) way of the stage during each pose of a run, degrees; 0 where it stood, or nothing tells.

    A stretch lasts as long as its samples, and turns as its pass does from the first to the last middle.
    """
    way_deg = np.zeros(len(poses))
    for is_dwell, group in groupby(range(len(poses)), key=lambda k: poses[k].settled):
        places = list(group)
        first, last = poses[places[0]], poses[places[-1]]
        if is_dwell or first.time_s is None or last.time_s is None or last.time_s <= first.time_s:
            continue
        velocity_dps = abs(last.theta_deg - first.theta_deg) / (last.time_s - first.time_s)
        way_deg[places] = [velocity_dps * _lasts_s(poses[k]) for k in places]
    return way_deg


def kept_in_mean(stretch_deg: FloatArray, period_deg: float) -> FloatArray:
    """Return (n,) share of a wave's amplitude that is left in the mean over each way (n,)."""
    return np.asarray(np.sinc(stretch_deg / period_deg), dtype=np.float64)


class Behind(NamedTuple):
    """How far what follows the stage through a first-order lag is behind it, each (n,), degrees.

    `mean_deg` over each pose, and `grown_deg` from the middle of the stretch before, or the end of the dwell,
    to the middle of the stretch, or the begin of the dwell: what a gyro feels less of.
    """

    mean_deg: FloatArray
    grown_deg: FloatArray


def behind(
    time_s: FloatArray, theta_deg: FloatArray, stretch_deg: FloatArray, starts: BoolArray, lag_s: float
) -> Behind:
    """Return what follows the stage through a lag, in a sweep whose first pose had settled.

    Between two stretches the stage turns evenly, before one it stood and behind one it comes to a stand, all
    at one velocity; dwells are as long as stretches are.

    `time_s` (n,) are the poses' middles, `stretch_deg` (n,) as `stretches_deg` has them; `starts` (n,) tells
    whether a pose is the first of its run. `lag_s` is a time constant.
    """
    turning = stretch_deg > 0.0
    way_deg, took_s = np.diff(theta_deg, prepend=theta_deg[:1]), np.diff(time_s, prepend=time_s[:1])
    evenly = turning & np.roll(turning, 1) & ~starts & (took_s > 0.0)
    if not evenly.any():
        return Behind(np.zeros(len(time_s)), np.zeros(len(time_s)))
    pace_dps = float(np.median(np.abs(way_deg[evenly] / took_s[evenly])))
    half = 0.5 * float(np.median(stretch_deg[turning])) / pace_dps / lag_s
    steady_deg = np.where(turning, np.sign(way_deg) * pace_dps * lag_s, 0.0)
    middle_deg = np.zeros(len(time_s))
    for k in np.flatnonzero(~starts).tolist():
        moved_s = min(abs(way_deg[k]) / pace_dps, took_s[k])
        stood, kept = np.exp(-(took_s[k] - moved_s) / lag_s), np.exp(-moved_s / lag_s)
        driven_deg = np.sign(way_deg[k]) * pace_dps * lag_s * (1.0 - kept)
        before_deg = middle_deg[k - 1] * (stood if turning[k] else 1.0)
        middle_deg[k] = (before_deg * kept + driven_deg) * (1.0 if turning[k] else stood)
    mean_deg = steady_deg + (middle_deg - steady_deg) * np.sinh(half) / half
    from_deg = np.roll(np.where(turning, middle_deg, middle_deg * np.exp(-half)), 1)
    to_deg = np.where(turning, middle_deg, middle_deg * np.exp(half))
    return Behind(mean_deg, np.where(starts, 0.0, to_deg - from_deg))


def _lasts_s(pose: Pose) -> float:
    return (pose.n_samples or 0) / pose.filtering.rate_hz if pose.filtering else 0.0


AS_IN_CONTRACT = Filtering()
SETTLE_S = 1.0
"""Where a pose does not say how long it settled: the default of a plan."""
FORGOTTEN = 1e-9
MOST_SAMPLES = 1_000_000
SHORTEST_MOVE_S = 1e-3
LEAST_GAIN_ERROR = 0.002
"""Of a gyro; below it the share of an error means nothing."""


def filter_share(poses: Sequence[Pose]) -> FloatArray:
    """Return (n,) κ of each pose: an error of the gyro of 1 % adds κ·1 % of the last move to its reading.

    A gyro that is wrong by g errs by g·rate(t) during the move. With h the steady filter's response from rate
    to angle (`SteadyStateGain`), T the duration of the move, s and d settling and dwell, and the error spread
    evenly:

        κ = 1/(T·d) ∫₀ᵀ dτ ∫ₛ^(s+d) dt h(t + τ)

    How long a move took is told by the stage's velocity and acceleration, and what else lies between two
    dwells belongs to settling: the stage was asked whether it stands, and the board for a fresh sample. Where
    they are not known the move took it all; without times it is a jump. The constants of the filter, rate and
    dwell are those that the poses know (`Pose.filtering`), else the contract's.

    The filter goes on by the newest rate, so that it is ahead by half a sampling interval Δt while the stage
    turns, and shows of that, after the move too,

        λ = Δt/(2·T·d) ∫ₛ^(s+d) dt (h(t + T) − h(t))

    times the move: at 200 Hz as much as of a gyro that is wrong by −0.4 %. Where the poses tell g, κ is that
    of both, κ + λ/g.
    """
    known = [pose.filtering or AS_IN_CONTRACT for pose in poses]
    settle_s = np.array([SETTLE_S if pose.settle_s is None else pose.settle_s for pose in poses])
    dwell_s = np.array([_dwell_s(pose, f) for pose, f in zip(poses, known, strict=True)])
    between_s = _between_s(poses, settle_s, dwell_s)
    ways_deg = np.abs(np.diff([pose.theta_deg for pose in poses], prepend=math.nan))
    travel_s = np.array([_travel_s(way, f) for way, f in zip(ways_deg, known, strict=True)])
    move_s = np.maximum(np.minimum(between_s, travel_s), SHORTEST_MOVE_S)
    settle_s = settle_s + np.maximum(between_s - move_s, 0.0)
    share, lead = np.empty(len(poses)), np.empty(len(poses))
    for noise, rate_hz in {(f.noise, f.rate_hz) for f in {id(f): f for f in known}.values()}:
        of_filter = np.array([(f.noise, f.rate_hz) == (noise, rate_hz) for f in known])
        share[of_filter], lead[of_filter] = _share_and_lead(
            noise, rate_hz, settle_s[of_filter], dwell_s[of_filter], move_s[of_filter]
        )
    gain_error = _gain_error(poses)
    if abs(gain_error) >= LEAST_GAIN_ERROR:
        share += lead / gain_error
    return np.where([f.remembers for f in known], share, 0.0)


def _dwell_s(pose: Pose, filtering: Filtering) -> float:
    if pose.filtering is not None and pose.n_samples:
        return pose.n_samples / filtering.rate_hz  # a dwell may end early
    return filtering.dwell_s


def _between_s(poses: Sequence[Pose], settle_s: FloatArray, dwell_s: FloatArray) -> FloatArray:
    """Return (n,) what lies between the dwell before and the settling; 0 where no times are known."""
    times = np.array([np.nan if pose.time_s is None else pose.time_s for pose in poses])
    between = np.diff(times, prepend=np.nan) - settle_s - (dwell_s + np.roll(dwell_s, 1)) / 2.0
    return np.maximum(np.nan_to_num(between, nan=0.0), 0.0)


def _travel_s(way_deg: float, filtering: Filtering) -> float:
    """Return how long the stage turns so far, by a trapezoid of velocity; inf where that is not known."""
    velocity, acceleration = filtering.velocity_dps, filtering.acceleration_dps2
    if velocity is None or acceleration is None or not way_deg > 0.0:
        return math.inf
    peak = min(velocity, math.sqrt(way_deg * acceleration))
    return way_deg / peak + peak / acceleration


def _gain_error(poses: Sequence[Pose]) -> float:
    """Of the gyro, by its account of the moves; 0 where it gives none."""
    felt_deg = [math.nan if pose.gyro_move_deg is None else pose.gyro_move_deg for pose in poses]
    turned_deg = np.diff([pose.theta_deg for pose in poses], prepend=math.nan)
    found = gyro_scale(turned_deg, felt_deg)
    return 0.0 if found is None else 1.0 / found.scale - 1.0


def _share_and_lead(
    noise: KalmanNoise, rate_hz: float, settle_s: FloatArray, dwell_s: FloatArray, move_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    longest_s = float((settle_s + dwell_s + move_s).max())
    once = _shown_error(noise, rate_hz, math.ceil(math.log2(min(longest_s * rate_hz, MOST_SAMPLES) + 2.0)))
    at = np.arange(1, len(once) + 1) / rate_hz
    end_s = settle_s + dwell_s

    def over_both(integral: FloatArray) -> FloatArray:
        """Over the dwell and the move, per second of both, by what has been integrated up to each time."""

        def of(t: FloatArray) -> FloatArray:
            return np.interp(t, at, integral, left=0.0)

        area = of(end_s + move_s) - of(end_s) - of(settle_s + move_s) + of(settle_s)
        return np.asarray(area / (move_s * dwell_s), dtype=np.float64)

    return over_both(np.cumsum(once) / rate_hz), over_both(once) / (2.0 * rate_hz)


@lru_cache(maxsize=8)
def _shown_error(noise: KalmanNoise, rate_hz: float, doublings: int) -> FloatArray:
    """Return what a filter shows after k samples of a rate that erred by 1 for the first one.

    It is an impulse response, of 2^doublings samples at most: until the filter has forgotten the error.
    scipy's filters would take longer to load than all else of a diagnosis' start.
    """
    gain = steady_state_gain(noise, 1.0 / rate_hz)
    _, a1, a2 = gain.denominator
    slowest = max(np.abs(np.roots(gain.denominator)))
    remembered = math.log(FORGOTTEN) / math.log(slowest) if slowest < 1.0 else math.inf
    now, before = (1.0 - gain.k_angle) / rate_hz, 0.0
    shown = []
    for _ in range(int(min(remembered + 2.0, 2.0**doublings))):
        shown.append(now)
        now, before = -a1 * now - a2 * before, now
    return np.array(shown)
