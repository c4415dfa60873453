"""Drafts of a unit's calibration, and who puts them in force: CONTRACT section 6."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Self

from calrig.analysis.calibration_in_force import (
    basis_of,
    changed_since,
    chosen_effects,
    why_none,
    why_not_now,
)
from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.imports import Imported
from calrig.analysis.known_calibration import Candidate, doubts_about, solution_doubts
from calrig.analysis.results import ending_of, fitted, gyro_of, reference_over
from calrig.analysis.solution_drafts import solution_changes, solved_content, solved_run, solved_verdict
from calrig.analysis.stored_runs import checked_reason, stored_run
from calrig.calibration.poses import Pose
from calrig.calibration.results import FittedResult
from calrig.calibration.uncertainty import REMOUNT_LIMIT_DEG, limit_for, make_verdict, to_dicts
from calrig.export.calibration_document import calibration_content
from calrig.model.result import Doubt, Result
from calrig.model.verdict import Verdict
from calrig.settings import ReleasePolicy, RigSettings
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Draft, Revision
from calrig.store.records import Document
from calrig.store.trail import EVERY_ENTRY

BROUGHT_OVER = "in force when this store began to issue revisions"


@dataclass(frozen=True, slots=True)
class Releases:
    """Who puts drafts in force: a rig's own `release`; of imports, the one of the first rig configured.

    Attributes:
        of_rig: the policy of each rig.
        default: of imports.
        remount_limits_deg: how far remounting may turn a unit on each rig; of others, the usual limit.
    """

    of_rig: dict[str, ReleasePolicy]
    default: ReleasePolicy = "auto"
    remount_limits_deg: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, rigs: Sequence[RigSettings]) -> Self:
        """As configured; `auto` where nothing is."""
        return cls(
            {rig.name: rig.release for rig in rigs},
            rigs[0].release if rigs else "auto",
            {rig.name: rig.remount_limit_deg for rig in rigs},
        )

    def puts_in_force(self, rig: str | None, judged: Verdict) -> bool:
        """Whether a draft with this verdict is in force as soon as it is made; never one that is in doubt."""
        policy = self.of_rig.get(rig or "", self.default)
        if not judged.reliable:
            return False
        return judged.answer != "fail" if policy == "auto" else policy == "pass" and judged.answer == "pass"

    def remount_limit_deg(self, rig: str | None) -> float:
        """How far remounting may turn a unit on a rig."""
        return self.remount_limits_deg.get(rig or "", REMOUNT_LIMIT_DEG)


@dataclass(frozen=True, slots=True)
class Fitted:
    """The poses of a run that count, what they give, and what was taken out beside bias and scale."""

    poses: Sequence[Pose]
    result: FittedResult
    accepted: Sequence[AcceptedEffect]
    excluded: Sequence[int] = ()
    chosen: Sequence[str] | None = None


@dataclass(frozen=True, slots=True)
class JudgedContent:
    """What a revision would say, why it would not be released by itself, and its verdict."""

    content: Document
    doubts: Sequence[Doubt]
    verdict: Verdict

    def draft(self, basis: Document, *, releases: bool, by: str | None, reason: str | None = None) -> Draft:
        """The draft of it. Doubts about effects that a person chose are not about the run's result."""
        doubts = to_dicts(self.doubts) if basis["chosen"] is None else None
        return Draft(self.content, basis, self.verdict.to_dict(), releases, by, reason, doubts)


class Issuer:
    """Makes drafts of stored runs, and releases and withdraws revisions."""

    def __init__(self, store: Store, releases: Releases | None = None) -> None:
        self._store = store
        self._releases = releases or Releases({})

    def completing(self, run: Run, fit: Fitted) -> Draft | None:
        """What the end of a run makes: the unit's next revision, or None.

        A verification, a static log and a follow-up make none, nor do poses that leave the scale open.
        """
        if why_none(run) is not None or fit.result.scale is None:
            return None
        return self._draft(run, fit, by=run.operator, reason=None)

    def importing(self, imported: Imported, *, by: str | None) -> Draft | None:
        """What poses make as they are imported; None where they are not about x, or leave the scale open."""
        content, result = imported.content, imported.result
        if content is None or result is None:
            return None
        judged = self._judged(Candidate(content["unit"], content["rig"]), result, content)
        releases = self._releases.puts_in_force(None, judged.verdict)
        basis = basis_of(imported.accepted, (), None)
        return judged.draft(basis, releases=releases, by=by)

    def draft(
        self,
        unit: str,
        run_id: str,
        effects: Sequence[str] | None = None,
        *,
        by: str | None = None,
        reason: str | None = None,
    ) -> Revision:
        """Makes a draft of a run, released at once where its rig's `release` says so.

        `run_id` is of a completed calibration of that unit; `effects` are names of its accepted effects that
        enter, None for all.

        Raises:
            Unknown: there is no such run.
            Conflict: the run gives no calibration, is of another unit, or an effect has not been accepted.
        """
        run = stored_run(self._store, run_id)
        if run.unit != unit:
            raise Conflict(f"run {run_id} is of unit {run.unit!r}, not of {unit!r}")
        if (why := why_none(run) or why_not_now(run)) is not None:
            raise Conflict(f"run {run_id} {why}: it gives no calibration")
        draft = self._draft(run, self._fit(run, effects), by=by, reason=reason)
        return self._store.revisions.issue(run_id, draft)

    def draft_solved(self, unit: str, solution_id: str, *, by: str | None, reason: str | None) -> Revision:
        """Makes a draft of what a joint solution says of a unit; released as its rig's `release` says.

        Raises:
            Unknown: the solution has no such unit.
            Conflict: the solution does not give one, or what it rests on has changed since.
        """
        solution = self._store.solutions.get(solution_id)
        run = solved_run(self._store, unit, solution)
        content, poses = solved_content(self._store, unit, solution), self._store.poses.of(run.id)
        runs = [stored_run(self._store, one) for one in solution.found.basis.runs]
        doubts = solution_doubts(self._store, [one for one in runs if one.unit == unit], content)
        content = _with_warnings(content, doubts)
        judged = solved_verdict(self._store, content, run, solution, poses, doubts)
        excluded = self._store.poses.excluded(run.id)
        basis = {**basis_of((), excluded, []), "solution": solution.id}
        releases = self._releases.puts_in_force(run.rig, judged)
        return self._store.revisions.issue(
            run.id, Draft(content, basis, judged.to_dict(), releases, by, reason)
        )

    def redraft(self, changed: Run, *, by: str | None, reason: str) -> Revision | None:
        """The unit's next draft, after a run or what was accepted from it has changed.

        It is of that run where its calibration is in force, else of the latest run that counts; none is made
        where a current revision of it rests on the same already. A joint solution in force gives way to no
        single run while its own counts: it is listed as stale, and to be solved again.
        """
        base = self._next_base(changed)
        if base is None:
            return None
        fit = self._fit(base)
        basis = basis_of(fit.accepted, fit.excluded, None)
        for one in self._store.revisions.of(base.unit):
            if one.run_id == base.id and one.status in ("draft", "in_force") and one.basis == basis:
                return None
        return self._store.revisions.issue(base.id, self._draft(base, fit, by=by, reason=reason))

    def lacks_draft(self, changed: Run) -> bool:
        """Return whether the unit has no current revision with its own effects and the poses as they are.

        Effects of the rig are left aside: they may have been accepted from another unit's run since.
        """
        base = self._next_base(changed)
        if base is None:
            return False
        accepted = self._store.effects.in_force(base.unit, base.rig)
        own = {effect.id for effect in accepted if effect.unit is not None}
        excluded = sorted(self._store.poses.excluded(base.id))
        for one in self._store.revisions.of(base.unit):
            if one.run_id != base.id or one.status not in ("draft", "in_force"):
                continue
            used = self._store.effects.by_id([int(number) for number in one.basis["effects"]])
            of_unit = {effect.id for effect in used if effect.unit is not None}
            if one.basis["chosen"] is None and (of_unit, one.basis["excluded"]) == (own, excluded):
                return False
        return True

    def _next_base(self, changed: Run) -> Run | None:
        """The run that a unit's next draft is of, after a run of it has changed; None if there is none."""
        in_force, now = self._store.revisions.in_force(changed.unit), stored_run(self._store, changed.id)
        is_of_unit = now.unit == changed.unit
        if in_force is not None and "solution" in in_force.basis and now.voided is None and is_of_unit:
            return None
        if in_force is not None and in_force.run_id == now.id and is_of_unit and not why_not_now(now):
            return now
        return self._store.runs.latest_calibration(changed.unit)

    def release(self, unit: str, number: int, *, by: str | None, reason: str | None) -> Revision:
        """Puts a draft or a superseded revision in force; a reason is kept with it where there is one.

        Raises:
            Refused: it is in force, or was withdrawn.
            Conflict: its run has been voided.
            Invalid: its document has warnings, and there is no reason.
        """
        with self._store.transaction():
            found = self._store.revisions.get(unit, number)
            if found is not None and found.warnings and not (reason or "").strip():
                raise Invalid(f"revision {number} has warnings: a reason is needed to release it", ["reason"])
            if found is not None and (voided := stored_run(self._store, found.run_id).voided):
                raise Conflict(f"run {found.run_id} of revision {number} is voided ({voided.reason})")
            why = None if reason is None else checked_reason(reason)
            return self._store.revisions.release(unit, number, by, why)

    def withdraw(self, unit: str, number: int, *, by: str | None, reason: str) -> Revision:
        """Withdraw a revision permanently.

        Raises:
            Refused: it has been withdrawn already.
        """
        return self._store.revisions.withdraw(unit, number, by, checked_reason(reason))

    def listed(self, revisions: Sequence[Revision]) -> list[Document]:
        """Revisions of one unit as CONTRACT section 2 lists them."""
        if not revisions:
            return []
        unit = revisions[0].unit
        in_force, acts = self._store.revisions.in_force(unit), _acts(self._store, unit)
        return [
            {
                "revision": one.revision,
                "status": one.status,
                "run_id": one.run_id,
                "effects": [effect["name"] for effect in one.document["effects"]],
                "issued_at": one.issued_at,
                "issued_by": one.issued_by,
                "reason": one.reason,
                "sha256": one.sha256,
                "verdict": one.verdict,
                "warnings": one.warnings,
                "stale": reasons,
                **_figures(one.document),
                "change": None if in_force is None else _change(one, in_force),
                "acts": acts.get(one.revision, []),
            }
            for one, reasons in zip(revisions, self._stale(revisions), strict=True)
        ]

    def bring_over(self) -> list[Revision]:
        """Issues what was in force of units from before there were revisions; each of them once."""
        made = []
        for unit in self._store.revisions.units_without():
            run = self._store.runs.latest_calibration(unit, follow_ups=True)
            if run is not None:
                draft = self._draft(run, self._fit(run), by=None, reason=BROUGHT_OVER, releases=True)
                made.append(self._store.revisions.issue(run.id, draft))
        return made

    def _stale(self, revisions: Iterable[Revision]) -> list[list[str]]:
        """Of each revision, what it rests on that has changed since it was made."""
        now: dict[str, tuple[Run, list[AcceptedEffect], list[int]]] = {}
        found = []
        for one in revisions:
            if one.run_id not in now:
                run = stored_run(self._store, one.run_id)
                accepted = self._store.effects.in_force(run.unit, run.rig)
                now[one.run_id] = run, accepted, self._store.poses.excluded(run.id)
            said = changed_since(one, *now[one.run_id])
            if (solution := one.basis.get("solution")) is not None:
                said = solution_changes(self._store, self._store.solutions.get(solution))
            found.append(said)
        return found

    def _fit(self, run: Run, chosen: Sequence[str] | None = None) -> Fitted:
        """A stored run's poses as they count now, with the effects accepted now."""
        accepted = chosen_effects(self._store.effects.in_force(run.unit, run.rig), chosen, run)
        stored = self._store.poses.of(run.id)
        poses = [one.pose for one in stored if one.excluded is None]
        excluded = [one.index for one in stored if one.excluded is not None]
        result = fitted(poses, accepted, run.provenance, gyro_of(run), ending_of(run), run.id)
        return Fitted(poses, result, accepted, excluded, chosen)

    def _draft(
        self, run: Run, fit: Fitted, *, by: str | None, reason: str | None, releases: bool | None = None
    ) -> Draft:
        content = calibration_content(
            unit=run.unit,
            rig=run.rig,
            poses=fit.poses,
            result=fit.result,
            accepted=fit.accepted,
            reference=reference_over(
                fit.poses, run.provenance, bent=fit.result.line_with_effects is not None
            ),
            provenance=run.provenance,
        )
        judged = self._judged(Candidate.of(run), fit.result, content, run.diagnosis)
        if releases is None:
            releases = self._releases.puts_in_force(run.rig, judged.verdict)
        basis = basis_of(fit.accepted, fit.excluded, fit.chosen)
        return judged.draft(basis, releases=releases, by=by, reason=reason)

    def _judged(
        self, new: Candidate, result: Result, content: Document, diagnosis: Document | None = None
    ) -> JudgedContent:
        """What a run would give its unit, with its doubts and its verdict."""
        remount_limit_deg = self._releases.remount_limit_deg(new.rig)
        doubts = doubts_about(self._store, new, result, content, remount_limit_deg)
        judged = make_verdict(
            result.with_doubts(doubts),
            diagnosis,
            limit=limit_for(self._store.limits.all(), new.unit, new.rig),
            calibration=content,
        )
        return JudgedContent(_with_warnings(content, doubts), doubts, judged)


def _with_warnings(content: Document, doubts: Sequence[Doubt]) -> Document:
    return {**content, "warnings": [one.says for one in doubts]}


class NoDrafts(Issuer):
    """The issuer of a bench: its centre drafts what it has been delivered, and numbers it."""

    def completing(self, run: Run, fit: Fitted) -> Draft | None:  # noqa: ARG002 (as of any issuer)
        """None."""
        return None


def _figures(document: Document) -> Document:
    covariance = document.get("covariance") or []
    stds = [math.sqrt(row[k]) for k, row in enumerate(covariance)]
    bias_std_deg, scale_std, *_ = [*stds, None, None]
    return {
        "bias_deg": document["bias_deg"],
        "bias_std_deg": bias_std_deg,
        "scale": document["scale"],
        "scale_std": scale_std,
        "expanded_uncertainty_deg": document.get("expanded_uncertainty_deg"),
    }


def _change(one: Revision, in_force: Revision) -> Document | None:
    if one.revision == in_force.revision:
        return None
    now, before = _figures(one.document), _figures(in_force.document)
    known = {name: (now[name], before[name]) for name in ("bias_deg", "scale", "expanded_uncertainty_deg")}
    less = {name: None if None in pair else pair[0] - pair[1] for name, pair in known.items()}
    return {"revision": in_force.revision, **less}


def _acts(store: Store, unit: str) -> dict[int | None, list[Document]]:
    acts: dict[int | None, list[Document]] = {}
    for entry in store.trail.entries(unit=unit, what=("released", "withdrawn"), limit=EVERY_ENTRY):
        said = {"at": entry.at, "what": entry.what, "by": entry.who, "reason": entry.reason}
        said["supersedes"] = entry.detail.get("supersedes")
        acts.setdefault(entry.revision, []).append(said)
    return acts


def issued_since(store: Store, since: datetime | None) -> list[Document]:
    """What was drafted, released and withdrawn over all units from a time on, oldest first."""
    if since is not None and since.tzinfo is None:
        since = since.replace(tzinfo=UTC)
    return [
        {
            "at": entry.at,
            "what": entry.what,
            "unit": entry.unit,
            "revision": entry.revision,
            "run_id": entry.run_id,
            "sha256": entry.detail["sha256"],
            "by": entry.who,
            "reason": entry.reason,
            "warnings": entry.detail.get("warnings", []),
            "supersedes": entry.detail.get("supersedes"),
        }
        for entry in store.trail.entries(
            what=("drafted", "released", "withdrawn"), since=since, limit=EVERY_ENTRY
        )
    ]
