"""Diagnoses of stored runs, and the acceptance of their effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.results import refitted
from calrig.analysis.revisions import Issuer
from calrig.analysis.stored_runs import (
    checked_reason,
    counted_poses,
    last_request,
    limits_of,
    poses_together,
    runs_together,
    stored_run,
)
from calrig.calibration.diagnosis import PartialResidual, partial_residuals, trace
from calrig.calibration.effects import EFFECTS
from calrig.calibration.poses import DiagnosisError
from calrig.calibration.regression import DiagnosisRequest
from calrig.store import AcceptedEffect, Store
from calrig.store.records import Run


class Diagnoses:
    """Traces what calibration left of stored runs, and remembers what was found."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def question(
        self, run_id: str, more: Sequence[str] = (), request: DiagnosisRequest | None = None
    ) -> Callable[..., dict[str, Any]]:
        """What a run's poses, with more runs of its unit and those it follows on, are to be asked.

        Args:
            run_id: the run.
            more: runs of its unit.
            request: what to assume; None for what its last diagnosis assumed, else what its rig said then.

        Returns:
            What gives the diagnosis, here or in another process, or raises DiagnosisError; its `progress` as
            of `trace`.

        Raises:
            Unknown: there is no such run.
            Conflict: a run is of another unit, or has not ended.
            Invalid: the poses are too many.
        """
        runs = runs_together(self._store, run_id, more)
        latest = runs[-1]
        return partial(
            trace,
            poses_together(self._store, runs),
            [run.id for run in runs],
            request=request or last_request(latest),
            plan=latest.plan,
            limits_deg=limits_of(latest),
            deciding=self._deciding(latest) if len(runs) > 1 else None,
        )

    def keep(self, run_id: str, found: dict[str, Any]) -> dict[str, Any]:
        """Keeps the answer with the run."""
        _keep_accepted(stored_run(self._store, run_id).diagnosis, found)
        self._store.runs.update(run_id, diagnosis=found)
        return found

    def last(self, run_id: str) -> dict[str, Any]:
        """The last diagnosis of a run (Unknown where it has none)."""
        found = stored_run(self._store, run_id).diagnosis
        if found is None:
            raise Unknown(f"run {run_id} has not been diagnosed")
        return found

    def partial_residuals(self, run_id: str) -> list[PartialResidual]:
        """Each effect of a run's last diagnosis in the poses it rests on, those of them that still count.

        Raises:
            Unknown: there is no such run, or it has not been diagnosed.
            Conflict: what counts now cannot show an effect any more; says what to do.
        """
        run, found = stored_run(self._store, run_id), self.last(run_id)
        runs = [counted_poses(self._store, earlier) for earlier in found["runs"][:-1]]
        decided_on = _decided_on(run) if runs else None
        latest = self._store.poses.of(run_id, include_excluded=False)
        runs.append([s.pose for s in latest if decided_on is None or s.index in decided_on])
        try:
            request = DiagnosisRequest.of_document(found)
            return partial_residuals(runs, found["effects"], found["runs"], request)
        except DiagnosisError as error:
            raise Conflict(f"run {run_id}: {error}") from error

    def _deciding(self, run: Run) -> list[int] | None:
        """Places, among the poses of a follow-up that count, of those that served to decide."""
        decided_on = _decided_on(run)
        if decided_on is None:
            return None
        counting = self._store.poses.of(run.id, include_excluded=False)
        return [place for place, stored in enumerate(counting) if stored.index in decided_on]


def _decided_on(run: Run) -> list[int] | None:
    """Indices of the poses of a follow-up that served to decide; None for any other run."""
    return (run.provenance.get("follow_up") or {}).get("decided_on")


def _keep_accepted(before: dict[str, Any] | None, found: dict[str, Any]) -> None:
    """An effect found once more with the very same values has been accepted; with others it has not."""
    for earlier in [] if before is None else before["effects"]:
        for effect in found["effects"]:
            if all(effect[key] == earlier[key] for key in ("name", "origin", "parameters")):
                effect["accepted_at"] = earlier.get("accepted_at")


class Acceptance:
    """What of diagnoses is in force."""

    def __init__(self, store: Store, issuer: Issuer | None = None) -> None:
        self._store = store
        self._issuer = issuer or Issuer(store)

    def accept(self, run_id: str, names: Sequence[str], *, who: str | None = None) -> Run:
        """Puts named effects of a run's diagnosis in force: the unit's own for it, the stage's for the rig.

        Of several of one name, such as the orders of a turn, all that can be accepted.

        Raises:
            Unknown: no such run, or it has not been diagnosed.
            Conflict: an effect is not in the diagnosis, or is none that later runs could be corrected for.
        """
        run, diagnosis = stored_run(self._store, run_id), Diagnoses(self._store).last(run_id)
        accepted = []
        for name in dict.fromkeys(names):
            found = [effect for effect in diagnosis["effects"] if effect["name"] == name]
            if not found:
                listed = ", ".join(dict.fromkeys(effect["name"] for effect in diagnosis["effects"])) or "none"
                raise Conflict(f"the diagnosis of run {run_id} has no effect {name!r}; it has: {listed}")
            accepted += _accepted_of(run, found)
        self._store.effects.accept(run_id, accepted, who=who)
        return self._refitted(run_id, who, f"accepted from run {run_id}: {_listed(names)}")

    def take_back(self, run_id: str, names: Sequence[str], reason: str, *, who: str | None = None) -> Run:
        """Takes effects that were accepted from a run out of force; an earlier acceptance is in force again.

        Raises:
            Unknown: there is no such run.
            Refused: an effect is not accepted from this run; says which are.
            Invalid: there is no reason.
        """
        stored_run(self._store, run_id)
        why = checked_reason(reason)
        self._store.effects.revoke(run_id, names, why, who=who)
        return self._refitted(run_id, who, f"{_listed(names)} of run {run_id} taken back: {why}")

    def _refitted(self, run_id: str, who: str | None, why: str) -> Run:
        """The run with its result as what is in force now gives it; its unit's next draft is made."""
        run = stored_run(self._store, run_id)
        if run.result is not None and run.kind != "verification":
            poses = counted_poses(self._store, run_id)
            run = self._store.runs.set_result(run_id, refitted(self._store, run, poses))
        self._issuer.redraft(run, by=who, reason=why)
        return run


def _listed(names: Sequence[str]) -> str:
    return ", ".join(name.replace("_", " ") for name in names)


def _is_change(effect: dict[str, Any]) -> bool:
    return effect.get("changed") is not None


def _accepted_of(run: Run, found: Sequence[dict[str, Any]]) -> list[AcceptedEffect]:
    """Those of one name that can be accepted; Conflict, with the first one's reason, if none can."""
    accepted, reasons = [], []
    for effect in sorted(found, key=_is_change):  # what was the same in all runs goes first
        try:
            accepted.append(_accepted(run, effect))
        except Conflict as reason:
            reasons.append(reason)
    if not accepted:
        raise reasons[0]
    return accepted


def _accepted(run: Run, effect: dict[str, Any]) -> AcceptedEffect:
    name, origin = effect["name"], effect["origin"]
    corrects = effect.get("corrects")  # absent in diagnoses of before
    if effect["verdict"] != "named" and corrects is None:
        raise Conflict(f"{name} is {effect['verdict']}, not named: separate it from its look-alikes first")
    if name not in EFFECTS:
        raise Conflict(f"{name} is not in the catalogue of this version of calrig: diagnose the run again")
    if _is_change(effect):
        raise Conflict(f"{name} changed between two runs: diagnose the latest alone, for the values in force")
    scope = corrects or EFFECTS[name].scope
    if scope == "run":
        raise Conflict(f"{name} ({origin}) cannot correct later runs: {effect['remedy']}")
    if scope == "rig" and run.rig is None:
        raise Conflict(f"{name} belongs to the stage, and run {run.id} names no rig")
    parameters = {key: value and value["value"] for key, value in effect["parameters"].items()}
    return AcceptedEffect(
        run_id=run.id,
        unit=run.unit if scope == "unit" else None,
        rig=run.rig if scope == "rig" else None,
        name=name,
        origin=origin,
        parameters=parameters,
    )
