"""Effects that people accept from a diagnosis, or take back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.issuing import Issuer
from calrig.analysis.results import refitted
from calrig.analysis.stored_runs import checked_reason, counted_poses, stored_run
from calrig.calibration.effects import EFFECTS
from calrig.store import AcceptedEffect, Run, Store


class Acceptance:
    """What of diagnoses is in force."""

    def __init__(self, store: Store, issuer: Issuer | None = None) -> None:
        self._store = store
        self._issuer = issuer or Issuer(store)

    def accept(self, run_id: str, names: Sequence[str], *, who: str | None = None) -> Run:
        """Puts named effects of a run's diagnosis in force: the unit's own for it, the stage's for the rig.

        Raises:
            Unknown: no such run, or it has not been diagnosed.
            Conflict: an effect is not in the diagnosis, or is none that later runs could be corrected for.
        """
        run = stored_run(self._store, run_id)
        if run.diagnosis is None:
            raise Unknown(f"run {run_id} has not been diagnosed")
        # what was the same in all runs goes before what changed between two of them
        found = sorted(run.diagnosis["effects"], key=_is_change, reverse=True)
        known = {effect["name"]: effect for effect in found}
        accepted = []
        for name in names:
            if name not in known:
                listed = ", ".join(known) or "none"
                raise Conflict(f"the diagnosis of run {run_id} has no effect {name!r}; it has: {listed}")
            accepted.append(_accepted(run, known[name]))
        self._store.accept_effects(run_id, accepted, who=who)
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
        self._store.take_back_effects(run_id, names, why, who=who)
        return self._refitted(run_id, who, f"{_listed(names)} of run {run_id} taken back: {why}")

    def _refitted(self, run_id: str, who: str | None, why: str) -> Run:
        """The run with its result as what is in force now gives it; its unit's next draft is made."""
        run = stored_run(self._store, run_id)
        if run.result is not None and run.kind != "verification":
            poses = counted_poses(self._store, run_id)
            run = self._store.set_result(run_id, refitted(self._store, run, poses))
        self._issuer.redraft(run, by=who, reason=why)
        return run


def _listed(names: Sequence[str]) -> str:
    return ", ".join(name.replace("_", " ") for name in names)


def _is_change(effect: dict[str, Any]) -> bool:
    return effect.get("changed") is not None


def _accepted(run: Run, effect: dict[str, Any]) -> AcceptedEffect:
    name, origin = effect["name"], effect["origin"]
    if effect["verdict"] != "named":
        raise Conflict(f"{name} is {effect['verdict']}, not named: separate it from its look-alikes first")
    if name not in EFFECTS:
        raise Conflict(f"{name} is not in the catalogue of this version of calrig: diagnose the run again")
    if _is_change(effect):
        raise Conflict(f"{name} changed between two runs: diagnose the latest alone, for the values in force")
    scope = EFFECTS[name].scope
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
