"""A unit's calibration: the run it is from, the exported document, and as a verification applies it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.results import effects_in_force, fitted
from calrig.analysis.stored_runs import counted_poses
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
from calrig.export.c_header import c_header
from calrig.export.calibration_json import calibration_document
from calrig.store import Run, Store
from calrig.store.records import Document


def active_run(store: Store, serial: str) -> Run:
    """The run that a unit's calibration is from.

    Raises:
        Unknown: the unit is not known, or has no completed, not voided calibration whose scale is known.
    """
    if store.unit(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    run = store.latest_calibration_run(serial)
    if run is None:
        raise Unknown(f"unit {serial!r} has no completed calibration that counts and whose scale is known")
    return run


def document_of(store: Store, run: Run) -> Document:
    """CONTRACT section 6 for one run, whether or not a later one is in force.

    Raises:
        Conflict: the run has none: it is voided, did not complete, or does not know its scale.
    """
    if run.voided is not None:
        raise Conflict(f"run {run.id} is voided ({run.voided['reason']}): it gives no calibration")
    if run.status != "completed" or run.result is None or run.result["scale"] is None:
        what = run.status if run.status != "completed" else "completed, but its scale is not known"
        raise Conflict(f"run {run.id} is {what}: it gives no calibration")
    return calibration_document(run, counted_poses(store, run.id), store.effects_in_force(run.unit, run.rig))


def header_of(store: Store, run: Run) -> str:
    """The same as `calibration.h`.

    Raises:
        Conflict: as for `document_of`, or an effect in force cannot be taken out in flight.
    """
    document = document_of(store, run)
    try:
        return c_header(document)
    except ValueError as error:
        raise Conflict(f"the calibration of run {run.id} cannot be put into C: {error}") from error


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
    poses = counted_poses(store, run.id)
    built = fitted(store, unit=run.unit, rig=rig, provenance=run.provenance, poses=poses)
    line = built.line_with_effects or built.line
    return ActiveCalibration(run.id, line, effects_in_force(store, run.unit, rig), built.reference)
