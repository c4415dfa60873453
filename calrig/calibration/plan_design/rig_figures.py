"""What a design rests on: how precise a reading is, and what time a rig takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

DATA_SHEET_WHITE = math.degrees(400e-6 / math.sqrt(2.0))
"""°·√s of an elevation by an MPU-6050: 400 µg/√Hz, one-sided (PS-MPU-6000A rev. 3.4, section 6.2)."""


@dataclass(frozen=True, slots=True)
class Precision:
    """Scatter of a reading about the line, by how long it dwells.

    Attributes:
        white_deg_rts: white noise: the mean over T seconds has this over √T, degrees.
        pose_deg: what scatters from pose to pose however long each is.
        said: where both are from, in words.
    """

    white_deg_rts: float
    pose_deg: float
    said: str

    def scatter_deg(self, dwell_s: float) -> float:
        """Standard deviation of a reading that dwells so long."""
        return math.hypot(self.white_deg_rts / math.sqrt(dwell_s), self.pose_deg)

    def dwell_s(self, scatter_deg: float) -> float:
        """How long to dwell for such a standard deviation; infinite where no dwell is long enough."""
        left = scatter_deg**2 - self.pose_deg**2
        return self.white_deg_rts**2 / left if left > 0.0 else math.inf


def precision_of_run(run_id: str, dwell_s: float, stderr_deg: float, scatter_deg: float) -> Precision:
    """As an earlier run had it: within its dwells, and what its residuals scatter beyond that.

    Args:
        run_id: for the words.
        dwell_s: of its poses.
        stderr_deg: pooled standard error of a reading, from within the dwells.
        scatter_deg: standard deviation of the residuals, with everything accepted taken out.
    """
    pose_deg = math.sqrt(max(scatter_deg**2 - stderr_deg**2, 0.0))
    said = (
        f"a reading of {dwell_s:g} s is good to {stderr_deg:.2g}° within its dwell, and poses scatter by "
        f"{pose_deg:.2g}° beyond that: run {run_id}"
    )
    return Precision(stderr_deg * math.sqrt(dwell_s), pose_deg, said)


NOT_MEASURED = Precision(
    DATA_SHEET_WHITE,
    0.0,
    "no completed run of this rig tells the noise: that of an MPU-6050's data sheet is assumed",
)


@dataclass(frozen=True, slots=True)
class Turning:
    """What a stage turns at without stopping: at most so fast, and how soon it has come up to that."""

    velocity_dps: float
    acceleration_dps2: float


@dataclass(frozen=True, slots=True)
class Pace:
    """What a rig takes for each thing that a plan asks of it.

    Attributes:
        travel_s: time of a move of so many degrees.
        settle_s: after each move.
        questions_s: at each pose, to the stage and the board.
        pass_s: likewise at each dwell of a sweep, with what follows from its stretches.
        begin_s: before the first move.
        stands_deg: elevation from which the first move begins.
    """

    travel_s: Callable[[float], float]
    settle_s: float
    questions_s: float
    begin_s: float
    stands_deg: float = 0.0
    pass_s: float = 0.0
