"""Whether the motor biases the accelerometer while it turns: a sweep's stretches against its dwells.

Vibration moves the mean of what is not linear: of the chip by its own second order and by clipping, of the
elevation by the arc tangent of what is shaken. How much an accelerometer scatters does not tell by how much,
only standing still does: the errors of the stretches, as a smooth curve of the elevation for each sense of
turning, are continued to the dwells that were come to in that sense. What the table itself turned there
beyond the stage's reports (a worm, a creep behind the motor) the gyro feels, and no vibration is that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.line import reading_error_deg
from calrig.calibration.poses import Pose
from calrig.estimation.angles import FloatArray

OWN_DEG = 0.01
"""What a step of the accelerometer (0.0035° at ±2 g) and the reckoning leave, with no motor running."""
SINGULAR = 1e-9
FEWEST_A_COLUMN = 2
"""Stretches of one pass."""
FELT_STD = 2.0
"""Standard errors: a turn that the gyro does not feel beyond them is none, and adds none of its noise."""


@dataclass(frozen=True, slots=True)
class UnreportedTurn:
    """What the gyro says that the table turned at the end of a pass beyond what the stage reported.

    Attributes:
        sense: of the pass, +1 or −1.
        turn_deg, std_deg: from the mean of the last stretch to that of the dwell, and what the gyro's noise
            and bias make of it.
    """

    sense: int
    turn_deg: float
    std_deg: float


@dataclass(frozen=True, slots=True)
class EndDifference:
    """How much more the unit reads at one end while the stage turns than standing.

    Attributes:
        elevation_deg: of the end.
        difference_deg, std_deg: turning less standing but for what the table turned, and its standard error.
        p_value: of so large a difference by chance.
    """

    elevation_deg: float
    difference_deg: float
    std_deg: float
    p_value: float

    def document(self) -> dict[str, Any]:
        """As it is kept with the run."""
        return {
            "elevation_deg": round(self.elevation_deg, 6),
            "difference_deg": round(self.difference_deg, 6),
            "std_deg": round(self.std_deg, 6),
            "p_value": self.p_value,
        }


@dataclass(frozen=True, slots=True)
class Ends:
    """What the ends of a sweep tell.

    Attributes:
        differences: of each end that is known.
        p_value: of all of them by chance, taken together: what shakes an accelerometer biases both.
    """

    differences: tuple[EndDifference, ...] = ()
    p_value: float = 1.0


def end_differences(poses: Sequence[Pose], unreported: Sequence[UnreportedTurn] = ()) -> Ends:
    """Return what the ends tell by all poses of a sweep so far; nothing where they are too few.

    `unreported` are of the passes that are known: of a run that was resumed, those since.

    A least-squares fit of the stretches: the first two harmonics, which offsets, gains and axes of a unit and
    the eccentricity of a stage make, a straight line, and the sense of turning. The scatter about it is taken
    for that of the dwells too. Student's t of the difference at each end, and Fisher's F of both.
    """
    stretches = [pose for pose in poses if pose.settle_s is None]
    dwells = [pose for pose in poses if pose.settle_s is not None]
    if not stretches:
        return Ends()
    both = len({pose.approach for pose in stretches}) > 1
    width = len({round(pose.target_deg) for pose in stretches}) // FEWEST_A_COLUMN
    design = _design(stretches, width, both=both)
    freedom = len(stretches) - design.shape[1]
    if width < 3 or freedom < 2:
        return Ends()
    beta = np.linalg.lstsq(design, _errors_deg(stretches), rcond=SINGULAR)[0]
    left = _errors_deg(stretches) - design @ beta
    variance = float(left @ left) / freedom
    spread = np.linalg.pinv(design.T @ design, rcond=SINGULAR**2)
    low, high = (f(pose.theta_deg for pose in stretches) for f in (min, max))
    rows, at, differences, own = [], [], [], []
    for sense in sorted({pose.approach for pose in stretches}, key=lambda s: s or 0):
        at_end = [pose for pose in dwells if pose.approach == sense and _is_end(pose, sense or 0, low, high)]
        if not at_end:
            continue
        turn_deg, turn_std_deg = _beyond_chance([one for one in unreported if one.sense == sense])
        rows.append(_design(at_end, width, both=both).mean(axis=0))
        at.append(at_end[0].target_deg)
        differences.append(float(rows[-1] @ beta) - float(_errors_deg(at_end).mean()) + turn_deg)
        own.append(variance / len(at_end) + turn_std_deg**2)
    if not rows:
        return Ends()
    covariance = variance * np.array(rows) @ spread @ np.array(rows).T + np.diag(own)
    return _tested(at, np.array(differences), covariance, freedom)


def _tested(
    at_deg: Sequence[float], differences_deg: FloatArray, covariance: FloatArray, freedom: int
) -> Ends:
    from scipy.special import fdtrc, stdtr

    stds_deg = np.sqrt(np.diag(covariance))
    by_chance = 2.0 * stdtr(freedom, -np.abs(differences_deg / stds_deg))
    found = zip(at_deg, differences_deg.tolist(), stds_deg.tolist(), by_chance.tolist(), strict=True)
    squares = float(differences_deg @ np.linalg.solve(covariance, differences_deg))
    together = fdtrc(len(stds_deg), freedom, squares / len(stds_deg))
    return Ends(tuple(EndDifference(*one) for one in found), float(together))


def disturbing(ends: Ends, chance: float) -> EndDifference | None:
    """Return the worse end, where they differ by more than chance, and the method's own error, allow."""
    if ends.p_value >= chance:
        return None
    found = [end for end in ends.differences if abs(end.difference_deg) > OWN_DEG]
    return min(found, key=lambda end: end.p_value, default=None)


def _beyond_chance(those: Sequence[UnreportedTurn]) -> tuple[float, float]:
    """Return the mean turn and its standard error; nothing where it is no more than the gyro's own error."""
    if not those:
        return 0.0, 0.0
    mean_deg = sum(one.turn_deg for one in those) / len(those)
    std_deg = math.sqrt(sum(one.std_deg**2 for one in those)) / len(those)
    return (mean_deg, std_deg) if abs(mean_deg) > FELT_STD * std_deg else (0.0, 0.0)


def _is_end(pose: Pose, sense: int, low_deg: float, high_deg: float) -> bool:
    """Return whether a dwell lies where a pass in this sense ends."""
    return pose.theta_deg > high_deg if sense > 0 else pose.theta_deg < low_deg


def _errors_deg(poses: Sequence[Pose]) -> FloatArray:
    theta = np.array([pose.theta_deg for pose in poses], dtype=np.float64)
    return reading_error_deg(theta, np.array([pose.reading_deg for pose in poses], dtype=np.float64))


def _design(poses: Sequence[Pose], width: int, *, both: bool) -> FloatArray:
    theta = np.radians([pose.theta_deg for pose in poses])
    ones = np.ones(len(poses))
    shapes = [ones, np.cos(theta), np.sin(theta), np.sin(2 * theta), np.cos(2 * theta), theta][:width]
    if both:
        shapes.append(np.array([pose.approach for pose in poses], dtype=np.float64))
    return np.column_stack(shapes)
