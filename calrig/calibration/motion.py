"""How the rig moved between and during the poses of one run, as far as their columns tell.

The order of rows is a history only where a column says so: a table of angles sorted by angle was not measured
as a sweep, and the step back across ±180° in it is no move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from calrig.calibration.pose import Pose
from calrig.calibration.pose_columns import column_of
from calrig.estimation.angles import FloatArray, wrap_deg

HISTORY = ("time_s", "sweep", "approach", "gyro_move_deg")
"""Any of these says that rows follow one another as they were measured."""
STANDING = ("reading_std_deg", "reading_stderr_deg", "n_samples", "settle_s", "gyro_move_deg", "filtering")
"""Any of these says that a pose is a dwell."""
TURN_DEG = 360.0
FEWEST = 4
AT_A_POSE = 1e-2
"""Share of an interval, within which a change is taken to have happened at the pose."""
ABRUPT = 0.2
"""Of the largest velocity: a change that no smooth motion makes between two readings."""
SHORTEST_LAG_S = 1e-6
SHORTEST_STOP_S = 1.0
"""Between poses, to move on, settle and take a mean: readings that follow faster were taken on the move."""


def has_history(poses: Sequence[Pose]) -> bool:
    """Whether a column tells that the poses come in the order measured."""
    return any(_tells(pose, HISTORY) for pose in poses)


def is_sorted(poses: Sequence[Pose]) -> bool:
    """Whether the order of the rows is that of their elevations, and nothing says that it is a history too.

    Readings that differ from row to row by little then are an error of the angle, not noise that wanders.
    """
    steps = _steps_deg(poses)[1:]
    return not has_history(poses) and bool((steps >= 0.0).all() or (steps <= 0.0).all()) and bool(steps.any())


def moves_deg(poses: Sequence[Pose]) -> FloatArray:
    """(n,) move into each pose of a run, degrees; NaN where there is none that is known.

    That is the first pose, all of a table without history, and all of a log taken on the move, whose readings
    follow on no move that had ended.
    """
    if not has_history(poses) or _taken_on_the_move(poses):
        return np.full(len(poses), np.nan)
    return _steps_deg(poses)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the stage moved while n readings were taken.

    Attributes:
        velocity_dps: (n,) at the time of each, deg/s.
        since_s, from_dps: (n,) time since the motion last changed abruptly, and the velocity before that.
        until_s, to_dps: (n,) time until it next does, and the velocity after that; infinite where it did not
            or nobody knows.
    """

    velocity_dps: FloatArray
    since_s: FloatArray
    from_dps: FloatArray
    until_s: FloatArray
    to_dps: FloatArray

    def mean_dps(self, lag_s: float) -> FloatArray:
        """(n,) mean velocity over a time before each reading; after it where `lag_s` is below 0."""
        near = (self.since_s, self.from_dps) if lag_s > 0.0 else (self.until_s, self.to_dps)
        share = np.minimum(near[0] / max(abs(lag_s), SHORTEST_LAG_S), 1.0)
        return np.asarray(share * self.velocity_dps + (1.0 - share) * near[1], dtype=np.float64)

    def rows(self, chosen: npt.NDArray[np.intp]) -> Motion:
        """The same of some of the readings."""
        return Motion(*(getattr(self, field.name)[chosen] for field in fields(self)))


def joined(motions: Sequence[Motion | None]) -> Motion | None:
    """The motion of several runs; None where it is not known of one."""
    known = [motion for motion in motions if motion is not None]
    if len(known) < len(motions):
        return None
    return Motion(*(np.concatenate([getattr(m, f.name) for m in known]) for f in fields(Motion)))


def motion_of(poses: Sequence[Pose]) -> Motion | None:
    """How the stage moved at a run's poses: as `velocity_dps` has it, else derived; None where not known.

    A log taken on the move tells it by its times and elevations: central differences, and next to a reversal
    the stroke that the pose is part of. Poses that stood have none, whatever lies between them.
    """
    given = [pose.covariates.get("velocity_dps") for pose in poses]
    known = [velocity for velocity in given if velocity is not None]
    if known and len(known) == len(given):
        never, nothing = np.full(len(known), np.inf), np.zeros(len(known))
        return Motion(np.array(known, dtype=np.float64), never, nothing, never, nothing)
    return _derived(poses) if _taken_on_the_move(poses) else None


def approach_of(poses: Sequence[Pose]) -> FloatArray | None:
    """(n,) sense of the move to each pose of a run: as given, else that of the motion it was taken in."""
    given = column_of(poses, "approach")
    if given is None and _taken_on_the_move(poses):
        return np.sign(_derived(poses).mean_dps(SHORTEST_LAG_S))
    return given


def _derived(poses: Sequence[Pose]) -> Motion:
    times_s = _times_s(poses)
    gap_s, way_deg = np.diff(times_s), _steps_deg(poses)[1:]
    pace = way_deg / gap_s
    at_s, from_dps, to_dps = _abrupt(times_s, pace)
    last = np.searchsorted(at_s, times_s + SHORTEST_LAG_S) - 1
    following = np.searchsorted(at_s, times_s - SHORTEST_LAG_S)
    at_s = np.concatenate([at_s, [np.inf, -np.inf]])  # index n: what never comes; −1: what never was
    since_s, until_s = np.maximum(times_s - at_s[last], 0.0), np.maximum(at_s[following] - times_s, 0.0)
    from_dps, to_dps = (np.concatenate([v, [0.0, 0.0]]) for v in (from_dps, to_dps))
    before, after = np.append(pace[:1], pace), np.append(pace, pace[-1:])
    central = np.concatenate(
        [pace[:1], (way_deg[:-1] + way_deg[1:]) / (times_s[2:] - times_s[:-2]), pace[-1:]]
    )
    turned = since_s < np.append(np.inf, gap_s)
    turning = until_s < np.append(gap_s, np.inf)
    velocity = np.select([turned & turning, turned, turning], [central, after, before], central)
    return Motion(velocity, since_s, from_dps[last], until_s, to_dps[following])


def _abrupt(times_s: FloatArray, pace: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """When the motion changed abruptly, from which velocity and to which, given those between n poses.

    That is where the strokes before and after an interval meet within it.
    """
    start_s, length_s = times_s[1:-2], np.diff(times_s)[1:-1]
    from_dps, to_dps = pace[:-2], pace[2:]
    jump = from_dps - to_dps
    is_jump = np.abs(jump) > ABRUPT * np.abs(pace).max()
    share = np.divide(pace[1:-1] - to_dps, jump, out=np.full(len(jump), -1.0), where=is_jump)
    within = (share > AT_A_POSE) & (share < 1.0 - AT_A_POSE)
    # beside an interval with a change in it, its mean looks like a change at the pose between
    at_end = (np.abs(share - 1.0) <= AT_A_POSE) & ~np.append(within[1:], False)
    at_start = (np.abs(share) <= AT_A_POSE) & ~np.append(False, within[:-1])
    found = within | at_end | at_start
    at_s = (start_s + np.clip(share, 0.0, 1.0) * length_s)[found]
    return at_s, from_dps[found], to_dps[found]


def _taken_on_the_move(poses: Sequence[Pose]) -> bool:
    """Whether readings follow faster than a stage could stop for them, and nothing says that it did."""
    if len(poses) < FEWEST or any(_tells(pose, STANDING) or pose.time_s is None for pose in poses):
        return False
    since_s = np.diff(_times_s(poses))
    return bool((since_s > 0.0).all() and np.median(since_s) < SHORTEST_STOP_S)


def _times_s(poses: Sequence[Pose]) -> FloatArray:
    return np.array([pose.time_s for pose in poses], dtype=np.float64)


def _steps_deg(poses: Sequence[Pose]) -> FloatArray:
    """(n,) elevation less that of the pose before, NaN for the first.

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
