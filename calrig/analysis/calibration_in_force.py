"""The basis of a unit's revisions, what has changed of it, and the revision that a verification applies."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.results import pose_residuals_deg, rest_on_map
from calrig.analysis.stored_runs import known_unit, stored_run
from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.regression import TEMPERATURE, ApplyError
from calrig.calibration.results import (
    AppliedEffect,
    FittedResult,
    Promise,
    as_clamped,
    basis_of_poses,
    corrected_residuals_deg,
    of_line_alone,
    own_effect,
    verify,
)
from calrig.estimation.angles import FloatArray
from calrig.export.calibration_document import line_of
from calrig.model.plan import CALIBRATING
from calrig.model.result import Gyro, ReferenceFigures, Result
from calrig.model.run import mount_axis
from calrig.run_ids import short_name
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Revision
from calrig.store.records import Document, as_applied, reference_of


def why_none(run: Run) -> str | None:
    """Why a run makes no calibration whatever it measures; None where it does.

    A verification applies one, a static log stands still, a follow-up has the poses that tell suspects apart,
    and about another axis than the unit's x there is no elevation.
    """
    if run.kind not in CALIBRATING:
        return f"is a {'static log' if run.kind == 'static' else run.kind}"
    if (axis := mount_axis(run.plan, run.provenance)) != "x":
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

    `excluded` are indices of poses; `chosen` names the unit's effects where a person named them, None for
    all.
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
        said.append(f"Run {short_name(run.id)} has been voided: {run.voided.reason}")
    if run.unit != revision.unit:
        said.append(f"Run {short_name(run.id)} belongs to unit {run.unit} now.")
        return said
    if sorted(excluded) != revision.basis["excluded"]:
        then, now = _poses(revision.basis["excluded"]), _poses(excluded)
        said.append(f"Poses of run {short_name(run.id)} excluded when it was issued: {then}; now: {now}.")
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
    return ", ".join(f"no. {index}" for index in sorted(indices)) or "none"


Wanted = int | Literal["latest"] | None
"""A revision by its number, the newest that was not withdrawn, or the one in force."""


def wanted_revision(store: Store, serial: str, wanted: Wanted = None) -> Revision:
    """A revision of a unit's calibration.

    Raises:
        Unknown: the unit is not known, or has none such.
    """
    known_unit(store, serial)
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
    promise: Promise | None = None

    def result(self, poses: Sequence[Pose], gyro: Gyro | None) -> FittedResult:
        """What it leaves of fresh poses; without the effects where the poses lack what they need."""
        try:
            return self._applied(poses, gyro, self._beside(poses), self.promise)
        except ApplyError:
            return self._applied(poses, gyro, (), of_line_alone(self.promise))

    def _applied(
        self,
        poses: Sequence[Pose],
        gyro: Gyro | None,
        effects: Sequence[AppliedEffect],
        promise: Promise | None,
    ) -> FittedResult:
        return verify(
            poses, gyro, self.line, effects, self.reference, promise, clamped_anew=self.clamped_anew
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


def active_calibration(
    store: Store, unit: str, rig: str | None, number: int | None, *, is_tested: bool = True
) -> ActiveCalibration:
    """The revision that a verification of a unit applies: bias, scale and effects as the document has them.

    The errors of the rig that it is made on are taken out beside: they are the stage's, not the unit's.

    The verification is made on `rig`; without `number` it is the revision in force. `is_tested` tells whether
    fresh poses are to be tested, which needs the poses behind the revision.

    Raises:
        Conflict: the unit has none such.
    """
    found = store.revisions.in_force(unit) if number is None else store.revisions.get(unit, number)
    if found is None:
        which = "calibration in force" if number is None else f"revision {number}"
        raise Conflict(f"unit {unit!r} has no {which} to verify: calibrate it first")
    document = found.document
    of_unit = [own_effect(e["name"], e["parameters"]) for e in document["effects"]]
    accepted = store.effects.in_force(unit, rig)
    of_rig = as_applied([e for e in accepted if e.unit is None])
    reference = _reference(document)
    solved = "solution" in document["provenance"] and not document["level_known"]
    line = line_of(document)
    return ActiveCalibration(
        found.revision,
        found.run_id,
        line,
        of_unit,
        reference,
        of_rig,
        solved,
        _promise(store, found, accepted, rig, line, of_unit) if is_tested else None,
    )


def require_not_withdrawn(store: Store, unit: str, number: int | None) -> None:
    """Raise Conflict if a unit's revision, named for a new verification, was withdrawn."""
    found = None if number is None else store.revisions.get(unit, number)
    if found is not None and found.status == "withdrawn":
        raise Conflict(
            f"revision {number} of unit {unit!r} has been withdrawn and is not verified: name another one, "
            "or none for the one in force"
        )


def _promise(
    store: Store,
    found: Revision,
    accepted: Sequence[AcceptedEffect],
    rig: str | None,
    line: Line,
    of_unit: Sequence[AppliedEffect],
) -> Promise:
    """Return the ranges of a revision, and the poses that its covariance follows from.

    Those are of its own run and of every other run that one of its effects was accepted from. Where a term of
    the temperature was fitted over several runs, the calibrated temperatures are those of all of them.
    """
    document = found.document
    warmth = document.get("temperature_c") or {}
    ends = warmth.get("min"), warmth.get("max")
    promise = Promise(
        range_deg=(document["range_deg"][0], document["range_deg"][1]),
        temperature_c=None if ends[0] is None or ends[1] is None else (ends[0], ends[1]),
        same_stage=document["rig"] is not None and document["rig"] == rig,
    )
    if "solution" in found.basis:
        return promise
    names = {name for name, _ in of_unit}
    of_names = [one for one in accepted if one.unit is not None and one.name in names]
    others = {run_id for one in of_names for run_id in one.rests_on}
    run_ids = [found.run_id, *sorted(others - {found.run_id})]
    runs = [[one.pose for one in store.poses.of(run_id, include_excluded=False)] for run_id in run_ids]
    over = {
        run_id
        for one in of_names
        if one.is_joint and own_effect(one.name, one.parameters) in of_unit
        if effect_of(one.name).covariate is TEMPERATURE
        for run_id in one.rests_on
    }
    if promise.temperature_c is not None:
        of_runs = [p.temperature_c for k, run_id in enumerate(run_ids) if run_id in over for p in runs[k]]
        known_c = [one for one in of_runs if one is not None] + [*promise.temperature_c]
        promise = replace(promise, temperature_c=(min(known_c), max(known_c)))
    # errors of the rig are in the readings of all runs alike, and lie within their scatter
    of_rig = as_applied(
        [one for one in store.effects.in_force(found.unit, document["rig"]) if one.unit is None]
    )
    beside = () if rest_on_map(runs[0]) else of_rig
    result = stored_run(store, found.run_id).result
    noise_deg = None if result is None else result.noise_deg
    basis = basis_of_poses(runs, line, of_unit, noise_deg, of_rig=beside)
    return replace(promise, basis=basis)


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


Fit = Literal["verdict", "plain"]
"""Of residuals: what the verdict judges, or what bias and scale alone leave (of a verification: its own)."""


def residuals_of(store: Store, run: Run, poses: Sequence[Pose], fit: Fit) -> list[float | None]:
    """Return the residual of each pose of a run by either model, degrees; as `left_of_poses_deg`."""
    if fit == "verdict" or run.result is None:
        return left_of_poses_deg(store, run, poses)
    number = run.provenance.get("verifies_revision")
    if number is None or store.revisions.get(run.unit, number) is None:
        return pose_residuals_deg(run, poses)
    applied = active_calibration(store, run.unit, run.rig, number, is_tested=False)
    return replace(applied, effects=[], of_rig=[]).left_deg(poses)


def left_of_poses_deg(store: Store, run: Run, poses: Sequence[Pose]) -> list[float | None]:
    """Return the residual that a run's verdict judges, of each pose, degrees.

    Of a verification, by the revision that it applied, effects taken out; of any other run, by its bias and
    scale, with the effects that its result has. None throughout before there is a result.

    `poses` are of the run; of one with effects, all, because some effects depend on the pose before.
    """
    number = run.provenance.get("verifies_revision")
    if number is None or store.revisions.get(run.unit, number) is None:
        return _with_effects_deg(store, run, poses) or pose_residuals_deg(run, poses)
    return active_calibration(store, run.unit, run.rig, number, is_tested=False).left_deg(poses)


def _with_effects_deg(store: Store, run: Run, poses: Sequence[Pose]) -> list[float | None] | None:
    """Return the residuals by the line and the effects of a run's result; None of one without effects."""
    result = run.result
    if result is None or result.rms_with_effects_deg is None or result.over_range is None:
        return None
    found = result.over_range
    line = Line(found.bias_deg, found.scale, None, None, None, None)
    of_unit, of_rig = _effects_of_result(store, run, result)
    try:  # a map has the rig's effects in it
        left_deg = corrected_residuals_deg(poses, line, of_unit if rest_on_map(poses) else of_unit + of_rig)
    except ApplyError:
        return None
    return [left if math.isfinite(left) else None for left in left_deg.tolist()]


def _effects_of_result(
    store: Store, run: Run, result: Result
) -> tuple[list[AppliedEffect], list[AppliedEffect]]:
    """Return the effects of the unit and of the rig that a run's result has.

    They are those of the run's newest revision with this result; of a run without one, those in force.
    """
    for one in store.revisions.of(run.unit):
        if one.run_id == run.id and one.document["rms_with_effects_deg"] == result.rms_with_effects_deg:
            used = store.effects.by_id([int(number) for number in one.basis["effects"]])
            of_unit = [own_effect(e["name"], e["parameters"]) for e in one.document["effects"]]
            return of_unit, as_applied([effect for effect in used if effect.unit is None])
    accepted = store.effects.in_force(run.unit, run.rig)
    own = as_applied([effect for effect in accepted if effect.unit is not None])
    return own, as_applied([effect for effect in accepted if effect.unit is None])
