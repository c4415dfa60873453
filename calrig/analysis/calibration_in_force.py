"""The basis of a unit's revisions, what has changed of it, and the revision that a verification applies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.results import as_applied, pose_residuals_deg, rest_on_map
from calrig.analysis.stored_runs import axis_of, stored_run
from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.regression import ApplyError
from calrig.calibration.results import (
    AppliedEffect,
    FittedResult,
    apply_calibration,
    as_clamped,
    corrected_residuals_deg,
    own_effect,
)
from calrig.estimation.angles import FloatArray
from calrig.export.calibration_document import line_of
from calrig.model.plan import CALIBRATING
from calrig.model.result import Gyro, ReferenceFigures
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Revision
from calrig.store.records import Document, reference_of


def why_none(run: Run) -> str | None:
    """Why a run makes no calibration whatever it measures; None where it does.

    A verification applies one, a static log stands still, a follow-up has the poses that tell suspects apart,
    and about another axis than the unit's x there is no elevation.
    """
    if run.kind not in CALIBRATING:
        return f"is a {'static log' if run.kind == 'static' else run.kind}"
    if (axis := axis_of(run)) != "x":
        return f"had the unit's {axis} along the stage's axis: its poses are for the joint solution"
    return None if run.follows is None else f"is a follow-up of run {run.follows}"


def why_not_now(run: Run) -> str | None:
    """Why a calibration run gives none as it is; None where it does."""
    if run.voided is not None:
        return f"is voided ({run.voided.reason})"
    if run.status != "completed" or run.result is None:
        return f"is {run.status}"
    return "does not know its scale" if run.result.scale is None else None


def basis_of(
    accepted: Sequence[AcceptedEffect], excluded: Sequence[int], chosen: Sequence[str] | None
) -> Document:
    """Return the basis of a draft in addition to its run, to be compared with the basis later.

    Args:
        accepted: effects that enter, of the unit and of its rig.
        excluded: indices of the run's poses that do not count.
        chosen: names of the unit's effects, where a person named them; None for all that are accepted.
    """
    return {
        "effects": {str(effect.id): effect.name for effect in accepted},
        "excluded": sorted(excluded),
        "chosen": None if chosen is None else sorted(chosen),
    }


def chosen_effects(
    accepted: Sequence[AcceptedEffect], names: Sequence[str] | None, run: Run
) -> list[AcceptedEffect]:
    """The accepted effects with those of the unit that a person named; the stage's are the rig's throughout.

    Raises:
        Conflict: one of the names has not been accepted for the unit.
    """
    if names is None:
        return list(accepted)
    own = {effect.name for effect in accepted if effect.unit is not None}
    for name in names:
        if name not in own:
            known = ", ".join(sorted(own)) or "none"
            raise Conflict(f"{name!r} is no accepted effect of unit {run.unit!r}; accepted: {known}")
    return [effect for effect in accepted if effect.unit is None or effect.name in names]


def changed_since(
    revision: Revision, run: Run, accepted: Sequence[AcceptedEffect], excluded: Sequence[int]
) -> list[str]:
    """What a revision rests on that has changed since it was made, a sentence each."""
    said = []
    if run.voided is not None:
        said.append(f"Run {run.id} has been voided: {run.voided.reason}")
    if run.unit != revision.unit:
        said.append(f"Run {run.id} belongs to unit {run.unit} now.")
        return said
    if sorted(excluded) != revision.basis["excluded"]:
        then, now = _poses(revision.basis["excluded"]), _poses(excluded)
        said.append(f"Excluded poses of run {run.id} were {then} and are {now}.")
    used, now_accepted = revision.basis["effects"], {str(e.id): e for e in accepted}
    chosen = revision.basis["chosen"]
    gone = sorted(name for key, name in used.items() if key not in now_accepted)
    new = [e for key, e in now_accepted.items() if key not in used]
    if chosen is not None:  # those of the unit that were left out were left out on purpose
        new = [effect for effect in new if effect.unit is None]
    if gone:
        said.append(f"No longer accepted as applied: {', '.join(gone)}.")
    if new:
        names = sorted(f"{e.name} (rig {e.rig})" if e.unit is None else e.name for e in new)
        said.append(f"Accepted since: {', '.join(names)}.")
    return said


def _poses(indices: Sequence[int]) -> str:
    return ", ".join(str(index) for index in sorted(indices)) or "none"


Wanted = int | Literal["latest"] | None
"""A revision by its number, the newest that was not withdrawn, or the one in force."""


def wanted_revision(store: Store, serial: str, wanted: Wanted = None) -> Revision:
    """A revision of a unit's calibration.

    Raises:
        Unknown: the unit is not known, or has none such.
    """
    if store.units.get(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    if wanted == "latest":
        found = next((one for one in store.revisions.of(serial) if one.status != "withdrawn"), None)
        none = f"unit {serial!r} has no calibration: none was completed, or all were withdrawn"
    elif wanted is None:
        found, none = store.revisions.in_force(serial), f"unit {serial!r} has no calibration in force"
    else:
        found, none = store.revisions.get(serial, wanted), f"unit {serial!r} has no revision {wanted}"
    if found is None:
        raise Unknown(none)
    return found


def newest_of_run(store: Store, run_id: str) -> Revision:
    """The newest revision that a run gave.

    Raises:
        Unknown: there is no such run.
        Conflict: it gave none.
    """
    run = stored_run(store, run_id)
    for one in store.revisions.of(run.unit):
        if one.run_id == run.id:
            return one
    why = why_none(run) or why_not_now(run) or "has no revision yet"
    raise Conflict(f"run {run_id} {why}: it gives no calibration")


@dataclass(frozen=True, slots=True)
class ActiveCalibration:
    """A revision as a verification applies it, on the rig that the verification is made on.

    `of_rig` are the errors of that rig, taken out beside where its stage's map does not have them already;
    `clamped_anew` says that a joint solution knows nothing of how the unit is clamped.
    """

    revision: int
    run_id: str
    line: Line
    effects: Sequence[AppliedEffect]
    reference: ReferenceFigures | None
    of_rig: Sequence[AppliedEffect] = ()
    clamped_anew: bool = False

    def result(self, poses: Sequence[Pose], gyro: Gyro | None) -> FittedResult:
        """What it leaves of fresh poses; without the effects where the poses lack what they need."""
        try:
            return self._applied(poses, gyro, self._beside(poses))
        except ApplyError:
            return self._applied(poses, gyro, ())

    def _applied(
        self, poses: Sequence[Pose], gyro: Gyro | None, effects: Sequence[AppliedEffect]
    ) -> FittedResult:
        return apply_calibration(
            poses, gyro, self.line, effects, self.reference, clamped_anew=self.clamped_anew
        )

    def _beside(self, poses: Sequence[Pose]) -> Sequence[AppliedEffect]:
        return self.effects if rest_on_map(poses) else [*self.effects, *self.of_rig]

    def provenance(self) -> Document:
        """What a verification's provenance says of it."""
        return {"verifies": self.run_id, "verifies_revision": self.revision}

    def left_deg(self, poses: Sequence[Pose]) -> list[float | None]:
        """As found against the document: calibrated elevation less the stage's, of each pose."""
        try:
            left = self._left_deg(poses, self._beside(poses))
        except ApplyError:
            left = self._left_deg(poses, ())
        return [value if math.isfinite(value) else None for value in left.tolist()]

    def _left_deg(self, poses: Sequence[Pose], effects: Sequence[AppliedEffect]) -> FloatArray:
        line = as_clamped(poses, self.line, effects) if self.clamped_anew else self.line
        return corrected_residuals_deg(poses, line, effects)


def active_calibration(store: Store, unit: str, rig: str | None, number: int | None) -> ActiveCalibration:
    """The revision that a verification of a unit applies: bias, scale and effects as the document has them.

    The errors of the rig that it is made on are taken out beside: they are the stage's, not the unit's.

    Args:
        store: where it is.
        unit: serial number.
        rig: that the verification is made on.
        number: of the revision; None for the one in force.

    Raises:
        Conflict: the unit has none such.
    """
    found = store.revisions.in_force(unit) if number is None else store.revisions.get(unit, number)
    if found is None:
        which = "calibration in force" if number is None else f"revision {number}"
        raise Conflict(f"unit {unit!r} has no {which} to verify: calibrate it first")
    document = found.document
    of_unit = [own_effect(e["name"], e["parameters"]) for e in document["effects"]]
    of_rig = as_applied([e for e in store.effects.in_force(unit, rig) if e.unit is None])
    reference = _reference(document)
    solved = "solution" in document["provenance"] and not document["level_known"]
    line = line_of(document)
    return ActiveCalibration(found.revision, found.run_id, line, of_unit, reference, of_rig, solved)


def _reference(document: Document) -> ReferenceFigures | None:
    """What the stage is worth in a document: its map where that was in force, else its certificate."""
    worth, stage = document["uncertainty"], reference_of(document["provenance"])
    by_map = worth.get("reference")
    if by_map is not None:
        return ReferenceFigures.model_validate(by_map)
    if stage is None or worth["reference_bias_deg"] is None:
        return None
    return ReferenceFigures(
        std_deg=stage.std_deg,
        kind=stage.kind,
        bias_std_deg=worth["reference_bias_deg"],
        scale_std=worth["reference_scale"],
        distribution=stage.distribution,
    )


def left_of_poses_deg(store: Store, run: Run, poses: Sequence[Pose]) -> list[float | None]:
    """What is left of each pose of a run, degrees.

    Of a verification, by the revision that it applied, effects taken out; of any other run, by its own bias
    and scale. None throughout before there is a result.
    """
    number = run.provenance.get("verifies_revision")
    if number is None or store.revisions.get(run.unit, number) is None:
        return pose_residuals_deg(run, poses)
    return active_calibration(store, run.unit, run.rig, number).left_deg(poses)
