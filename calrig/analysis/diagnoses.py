"""Diagnoses of stored runs, and the acceptance of their effects."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.joint_model import joint_of_accepting, joint_of_rest, known_stds
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
from calrig.analysis.unit_of_work import Fits, in_one_transaction
from calrig.calibration.diagnosis import PartialResidual, partial_residuals, trace
from calrig.calibration.effects import EFFECTS, title_inside
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.regression import ApplyError, DiagnosisRequest
from calrig.calibration.results import own_effect, poses_without_effects
from calrig.run_ids import short_name
from calrig.store import AcceptedEffect, Store
from calrig.store.records import Run, as_applied


class Diagnoses:
    """Traces what calibration left of stored runs, and remembers what was found."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def question(
        self, run_id: str, more: Sequence[str] = (), request: DiagnosisRequest | None = None
    ) -> Callable[..., dict[str, Any]]:
        """What a run's poses, with more runs of its unit and those it follows on, are to be asked.

        `more` are runs of its unit. `request` is what to assume; None for what its last diagnosis assumed,
        else what its rig said then.

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
            traced,
            self._in_force(runs),
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
        taken = [own_effect(one["name"], one["parameters"]) for one in found.get("in_force", [])]
        try:
            request = DiagnosisRequest.of_document(found)
            left = [poses_without_effects(poses, taken) for poses in runs] if taken else runs
            return partial_residuals(left, found["effects"], found["runs"], request)
        except (DiagnosisError, ApplyError) as error:
            raise Conflict(f"run {run_id}: {error}") from error

    def _in_force(self, runs: Sequence[Run]) -> list[AcceptedEffect]:
        """The unit's effects in force that were accepted from other runs than these."""
        unit, ids = runs[-1].unit, {run.id for run in runs}
        own = {one.name for one in self._store.effects.acceptances(unit) if one.run_id in ids}
        in_force = self._store.effects.in_force(unit, None)
        return [one for one in in_force if one.unit is not None and one.name not in own]

    def _deciding(self, run: Run) -> list[int] | None:
        """Places, among the poses of a follow-up that count, of those that served to decide."""
        decided_on = _decided_on(run)
        if decided_on is None:
            return None
        counting = self._store.poses.of(run.id, include_excluded=False)
        return [place for place, stored in enumerate(counting) if stored.index in decided_on]


def traced(
    in_force: Sequence[AcceptedEffect], runs: Sequence[Sequence[Pose]], run_ids: Sequence[str], **how: Any
) -> dict[str, Any]:
    """The diagnosis of poses once the effects in force for their unit are taken out of them; as `trace`.

    The document lists these under `in_force`. Where the poses lack what one is a function of, none is taken
    out and a warning says so.
    """
    taken = as_applied(in_force)
    try:
        left = [poses_without_effects(poses, taken) for poses in runs] if taken else runs
    except ApplyError as error:
        found = trace(runs, run_ids, **how)
        names = ", ".join(name for name, _ in taken)
        warning = f"effects in force are not taken out ({names}): {error}"
        return {**found, "in_force": [], "warnings": [*found["warnings"], warning]}
    listed = [{"name": e.name, "parameters": e.parameters, "runs": e.rests_on} for e in in_force]
    return {**trace(left, run_ids, **how), "in_force": listed}


def _decided_on(run: Run) -> list[int] | None:
    """Indices of the poses of a follow-up that served to decide; None for any other run."""
    return (run.provenance.get("follow_up") or {}).get("decided_on")


def _keep_accepted(before: dict[str, Any] | None, found: dict[str, Any]) -> None:
    """An effect found once more with the very same values has been accepted; with others it has not.

    Where effects of other runs are in force, they move the values of these poses as they are fitted again.
    """
    if before is None:
        return
    refitted = bool(found.get("in_force")) and before.get("runs") == found["runs"]
    names = Counter(effect["name"] for document in (before, found) for effect in document["effects"])
    for earlier in before["effects"]:
        for effect in found["effects"]:
            is_one = all(effect[key] == earlier[key] for key in ("name", "origin"))
            moved = refitted and names[effect["name"]] == 2  # of several of one name none knows its like
            is_same = moved or effect["parameters"] == earlier["parameters"]
            if is_one and is_same:
                effect["accepted_at"] = earlier.get("accepted_at")


class Acceptance:
    """What of diagnoses is in force."""

    def __init__(self, store: Store, issuer: Issuer | None = None) -> None:
        self._store = store
        self._issuer = issuer or Issuer(store)

    def accept(self, run_id: str, names: Sequence[str], *, who: str | None = None) -> Run:
        """Puts named effects of a run's diagnosis in force: the unit's own for it, the stage's for the rig.

        Of several of one name, such as the orders of a turn, all that can be accepted. The unit's are fitted
        together with those accepted from its other runs, over the poses of all of them.

        Raises:
            Unknown: no such run, or it has not been diagnosed.
            Conflict: an effect is not in the diagnosis, or is none that later runs could be corrected for;
                or one of the runs would be predicted worse than before.
        """
        return in_one_transaction(self._store, lambda fits: self._accept(run_id, names, who, fits))

    def _accept(self, run_id: str, names: Sequence[str], who: str | None, fits: Fits) -> Run:
        run, diagnosis = stored_run(self._store, run_id), Diagnoses(self._store).last(run_id)
        accepted: list[AcceptedEffect] = []
        left: list[str] = []
        for name in dict.fromkeys(names):
            found = [effect for effect in diagnosis["effects"] if effect["name"] == name]
            if not found:
                listed = ", ".join(dict.fromkeys(effect["name"] for effect in diagnosis["effects"])) or "none"
                raise Conflict(f"the diagnosis of run {run_id} has no effect {name!r}; it has: {listed}")
            acceptable, reasons = _accepted_of(run, found)
            accepted, left = [*accepted, *acceptable], [*left, *reasons]
        others = _others_of_unit(diagnosis, names)
        accepted, joint = joint_of_accepting(self._store, run.unit, accepted, fits, others)
        self._store.effects.accept(run_id, accepted, joint, who=who)
        said = [f"accepted from run {short_name(run_id)}: {_listed(names, run)}", *left]
        return self._refit(run_id, who, "; left out: ".join(said))

    def take_back(self, run_id: str, names: Sequence[str], reason: str, *, who: str | None = None) -> Run:
        """Takes effects that were accepted from a run out of force; an earlier acceptance is in force again.

        Raises:
            Unknown: there is no such run.
            Refused: an effect is not accepted from this run; says which are.
            Invalid: there is no reason.
        """
        why = checked_reason(reason)
        return in_one_transaction(self._store, lambda fits: self._take_back(run_id, names, why, who, fits))

    def _take_back(self, run_id: str, names: Sequence[str], why: str, who: str | None, fits: Fits) -> Run:
        run = stored_run(self._store, run_id)
        left = [
            one
            for one in self._store.effects.acceptances(run.unit)
            if one.run_id != run_id or one.name not in names
        ]
        self._store.effects.revoke(run_id, names, why, joint_of_rest(self._store, left, fits), who=who)
        reason = f"{_listed(names, run)} of run {short_name(run_id)} taken back: {why}"
        return self._refit(run_id, who, reason)

    def _refit(self, run_id: str, who: str | None, why: str) -> Run:
        """Fit a run's result again with what is in force now, and make its unit's next draft."""
        run = stored_run(self._store, run_id)
        if run.result is not None and run.kind != "verification":
            poses = counted_poses(self._store, run_id)
            run = self._store.runs.update(run_id, result=refitted(self._store, run, poses))
        self._issuer.redraft(run, by=who, reason=why)
        return run


def _listed(names: Sequence[str], run: Run) -> str:
    """Return the titles of effects of a run's diagnosis, each with those that it may be as well."""
    diagnosis = run.diagnosis or {"effects": []}
    is_good = diagnosis.get("reference") == "good"
    told = []
    for name in names:
        rivals = [r for e in diagnosis["effects"] if e["name"] == name for r in e["confusable_with"]]
        titles = (title_inside(one, reference_is_good=is_good) for one in (name, *rivals))
        told.append(" or ".join(dict.fromkeys(titles)))
    return ", ".join(told)


def _is_change(effect: dict[str, Any]) -> bool:
    return effect.get("changed") is not None


def _others_of_unit(diagnosis: dict[str, Any], names: Sequence[str]) -> list[str]:
    """Return names of the unit's effects of a diagnosis that can be accepted, were not, and are not now."""
    still_open = (e for e in diagnosis["effects"] if e.get("corrects") == "unit" and not e.get("accepted_at"))
    return [name for name in dict.fromkeys(e["name"] for e in still_open) if name not in names]


def _accepted_of(run: Run, found: Sequence[dict[str, Any]]) -> tuple[list[AcceptedEffect], list[str]]:
    """Those of one name that can be accepted, and why the others cannot.

    Raises:
        Conflict: none can; with the first one's reason.
    """
    accepted, reasons = [], []
    for effect in sorted(found, key=_is_change):  # what was the same in all runs goes first
        try:
            accepted.append(_accepted(run, effect))
        except Conflict as reason:
            reasons.append(str(reason))
    if not accepted:
        raise Conflict(reasons[0])
    return accepted, reasons


def _accepted(run: Run, effect: dict[str, Any]) -> AcceptedEffect:
    name, origin = effect["name"], effect["origin"]
    corrects = effect.get("corrects")  # absent in diagnoses of before
    if effect["verdict"] != "named" and corrects is None:
        period = effect["parameters"].get("period_deg")
        which = name if period is None else f"{name} of {period['value']:.4g}°"
        raise Conflict(f"{which} is {effect['verdict']}, not named: separate it from its look-alikes first")
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
    assert run.diagnosis is not None  # noqa: S101 (the effect is of it)
    return AcceptedEffect(
        run_id=run.id,
        unit=run.unit if scope == "unit" else None,
        rig=run.rig if scope == "rig" else None,
        name=name,
        origin=origin,
        parameters=parameters,
        runs=run.diagnosis.get("runs", [run.id]),
        std=known_stds(effect["parameters"]),
        is_partial=bool(run.diagnosis.get("in_force")),
    )
