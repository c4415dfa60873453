"""What is in force for a unit on a rig: accepted effects, and the calibration that a verification applies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calrig.analysis.errors import Conflict
from calrig.analysis.results import effects_in_force, fitted
from calrig.calibration.effect import ApplyError
from calrig.calibration.fit import Line
from calrig.calibration.pose import Pose
from calrig.calibration.result import (
    AppliedEffect,
    GyroFigures,
    ReferenceFigures,
    Result,
    apply_calibration,
)
from calrig.store import Store


@dataclass(frozen=True, slots=True)
class ActiveCalibration:
    """A unit's calibration as a verification applies it."""

    run_id: str
    line: Line
    effects: Sequence[AppliedEffect]
    reference: ReferenceFigures | None

    def result(self, poses: Sequence[Pose], gyro: GyroFigures | None) -> Result:
        """What it leaves of fresh poses; without the effects where the poses lack what they need."""
        try:
            return apply_calibration(poses, gyro, self.line, self.effects, self.reference)
        except ApplyError:
            return apply_calibration(poses, gyro, self.line, (), self.reference)


def active_calibration(store: Store, unit: str, rig: str | None) -> ActiveCalibration:
    """The calibration that a verification of a unit on a rig applies.

    Raises:
        Conflict: the unit has none.
    """
    run = store.latest_calibration_run(unit)
    if run is None:
        raise Conflict(f"unit {unit!r} has no calibration in force to verify: calibrate it first")
    return as_applied(store, run.id, rig)


def as_applied(store: Store, run_id: str, rig: str | None) -> ActiveCalibration:
    """The calibration that a completed run gives its unit, as it is applied on a rig.

    Raises:
        Conflict: there is no such run any more.
    """
    run = store.run(run_id)
    if run is None:
        raise Conflict(f"there is no run {run_id} whose calibration could be applied")
    poses = [stored.pose for stored in store.poses(run.id, include_excluded=False)]
    built = fitted(store, unit=run.unit, rig=rig, provenance=run.provenance, poses=poses)
    line = built.line_with_effects or built.line
    return ActiveCalibration(run.id, line, effects_in_force(store, run.unit, rig), built.reference)
