"""Sequential stopping: when a run has reached its goal, and the scatter that is then stated.

Who looks after every pose stops at the one after which the poses happen to lie too near the line. Its scatter
is therefore stated with care (`cautious`), by one rule for the decision and for all that is said of the run
afterwards. `python -m tests.studies.plans coverage` measures what the stated uncertainties then cover.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.uncertainty.coverage import coverage_factor
from calrig.model.plan import FEWEST_UNTIL
from calrig.model.result import StoppedBy

SPENT = 2
"""Degrees of freedom that looking after each pose costs."""
NEAR_AN_END = 0.05
"""Share of the range."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run came to its end.

    Attributes:
        may_be_early: sequential stopping, looked at after each pose.
        stopped_by: what ended it.
    """

    may_be_early: bool = False
    stopped_by: StoppedBy = "plan"


AS_PLANNED = Ending()


def caution(n_poses: int) -> float:
    """By how much the scatter of so many poses is stated larger."""
    return math.sqrt((n_poses - 2) / max(n_poses - 2 - SPENT, 1))


def cautious(line: Line, n_poses: int, noise_deg: float | None) -> Line:
    """The line with a scatter that holds although the run ended when it was found to be small.

    s²·(n − 2)/(n − 4) is stated for s², and never less than the noise within the dwells shows: that is
    independent of the residuals, which therefore do not stop the run by chance where there is nothing beside
    it. It is known much better than n − 2 degrees of freedom tell, so that of the noise z/t enters, with the
    quantiles of the normal distribution and of Student's t for n − 2: k times that is z times the noise.

    Args:
        line: through the poses, by their own scatter.
        n_poses: how many.
        noise_deg: pooled standard error of a reading, from within its dwell.
    """
    if line.covariance is None or not line.residual_std_deg:
        return line
    freedom = n_poses - 2 - line.effect_parameters
    own_deg = caution(n_poses) * line.residual_std_deg
    known = coverage_factor(1.0, math.inf, 0.0, "normal") / coverage_factor(1.0, freedom, 0.0, "normal")
    return widened(line, max(own_deg, known * (noise_deg or 0.0)) / line.residual_std_deg)


def widened(line: Line, more: float) -> Line:
    """The line with scatter and standard errors larger by a factor; as it is where they are not known."""
    if line.covariance is None or line.residual_std_deg is None:
        return line
    (bias, shared), (_, scale) = line.covariance
    return replace(
        line,
        bias_std_deg=more * math.sqrt(bias),
        scale_std=more * math.sqrt(scale),
        covariance=((more**2 * bias, more**2 * shared), (more**2 * shared, more**2 * scale)),
        residual_std_deg=more * line.residual_std_deg,
    )


def turned_both_ways(poses: Sequence[Pose]) -> bool:
    """Whether stretches of a sweep were turned upward and downward; so they were where there are none.

    What a sweep's delay is wrong by lifts every stretch of one sense and lowers every one of the other: one
    way alone has it in the bias, and no scatter tells (`python -m tests.studies.plans coverage`).
    """
    return len({pose.approach for pose in poses if not pose.settled}) != 1


def has_the_line(visited_deg: Sequence[float], planned_deg: Sequence[float]) -> bool:
    """Whether there are poses enough for a line, and at both ends of the range that is planned."""
    low, high = min(planned_deg), max(planned_deg)
    near_deg = NEAR_AN_END * (high - low)
    return (
        len(visited_deg) >= FEWEST_UNTIL
        and min(visited_deg) <= low + near_deg
        and max(visited_deg) >= high - near_deg
    )
