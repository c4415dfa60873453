"""Each pose of a run held against what its stage says, as it is taken (`calrig.calibration.move_check`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.move_check import MoveCheck, MoveWatch, gyro_move_std_deg
from calrig.calibration.poses import Pose
from calrig.estimation.angles import along_axis
from calrig.instruments.errors import StageError
from calrig.instruments.types import Samples

KIND = "move_mismatch"
"""Of a run's faults, and of the event that tells of one."""
REPLAYED_STD_DEG = 0.05
"""Of the gyro over a move whose samples were let go of."""
FULL_SCALE = 0.98
"""A rate nearer to the end of the gyro's range may have been cut off."""


class FeltMoves:
    """What the unit has felt of a run's moves. `moves` pairs the stage's turn with the gyro's, degrees.

    `axis` is which of the unit's lies along the stage's; reversed, the unit turns against it.
    """

    def __init__(self, poses: list[Pose], gyro_range_dps: int | None, axis: str = "x") -> None:
        self.moves: list[tuple[float, float]] = []
        self._range_dps = gyro_range_dps
        self._watch = MoveWatch()
        self._axis, self._sense = axis, -1 if axis.startswith("-") else 1
        last_deg: float | None = None
        clamped_deg: float | None = None
        for pose in poses:
            if clamped_deg is not None and pose.mount_deg != clamped_deg:
                self.touched()
            turned_deg = None if last_deg is None or pose.stage_deg is None else pose.stage_deg - last_deg
            self._note(pose, turned_deg, self._judged(pose, turned_deg, REPLAYED_STD_DEG))
            last_deg, clamped_deg = pose.stage_deg, pose.mount_deg
        self.touched()  # nobody saw what happened before the run went on

    def touched(self) -> None:
        """Somebody had the unit in hand: its elevation at the last pose is not that before the next move."""
        self._watch.touched()

    def take(
        self, now: Pose, turned_deg: float | None, move: Samples, bias_std_dps: float | None, dwell_s: float
    ) -> MoveCheck | None:
        """Judges the move into a pose by its samples; None where nothing tells of it."""
        rate_dps = along_axis(move.gyro_dps, self._axis)[:, 0]
        felt = now
        if self._range_dps is not None and np.abs(rate_dps).max(initial=0.0) > FULL_SCALE * self._range_dps:
            felt = replace(now, gyro_move_deg=None)
        std_deg = gyro_move_std_deg(move.time_s, rate_dps, bias_std_dps, dwell_s)
        check = self._judged(felt, turned_deg, std_deg if felt.gyro_move_deg is not None else 0.0)
        self._note(felt, turned_deg, check)
        return check

    def _judged(self, pose: Pose, turned_deg: float | None, gyro_std_deg: float) -> MoveCheck | None:
        """Holds a move against what the unit felt about the axis that lies along the stage's."""
        if self._axis != "x":
            pose = self._as_about_x(pose)
        turned_deg = None if turned_deg is None else self._sense * turned_deg
        check = self._watch.take(pose, turned_deg, gyro_std_deg)
        if check is None or self._sense > 0:
            return check
        return replace(
            check,
            stage_deg=-check.stage_deg,
            felt_deg=-check.felt_deg,
            gyro_deg=None if check.gyro_deg is None else -check.gyro_deg,
            gravity_deg=None if check.gravity_deg is None else -check.gravity_deg,
        )

    def _as_about_x(self, pose: Pose) -> Pose:
        """The pose of a unit that turned about its x, in the sense in which it turns."""
        vector = np.array([[pose.accel_x_g, pose.accel_y_g, pose.accel_z_g]], dtype=np.float64)
        x, y, z = along_axis(vector, self._axis)[0].tolist()
        stage_deg = None if pose.stage_deg is None else self._sense * pose.stage_deg
        return replace(pose, accel_x_g=x, accel_y_g=y, accel_z_g=z, stage_deg=stage_deg)

    def _note(self, now: Pose, turned_deg: float | None, check: MoveCheck | None) -> None:
        """A move that was not what the stage says is none to learn the gyro's scale from."""
        if now.gyro_move_deg is not None and turned_deg is not None and check and check.verdict == "agrees":
            self.moves.append((self._sense * turned_deg, now.gyro_move_deg))


def told(index: int, pose: Pose, check: MoveCheck) -> tuple[str, dict[str, Any]]:
    """The event of a move that was felt otherwise."""
    data = {
        "index": index,
        "target_deg": pose.target_deg,
        "stage_move_deg": check.stage_deg,
        "felt_move_deg": check.felt_deg,
        "difference_deg": check.difference_deg,
        "std_deg": check.std_deg,
        "gyro_deg": check.gyro_deg,
        "gravity_deg": check.gravity_deg,
        "ends_run": check.verdict == "lost",
        "says": f"Pose {index} at {pose.target_deg:g}°: {check.words()}.",
    }
    return KIND, data


def lost(index: int, pose: Pose, check: MoveCheck) -> StageError:
    """The end of a run whose stage is not where it says."""
    return StageError(
        f"pose {index} at {pose.target_deg:g}°: {check.words()}. The stage lost steps or slips, or "
        "the unit came loose or is clamped the other way round, or ratio or sign of the rig is wrong: free "
        "the stage, see that the unit sits tight and as the plan says, home the stage (without homing: turn "
        'it to a known angle, and say so with --stage-at or "The stage stands at" on the page), and start a '
        "new run"
    )
