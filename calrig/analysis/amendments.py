"""What is done to runs after they were measured, or instead: import, void, move. Nothing is deleted."""

from collections.abc import Callable, Sequence, Set
from functools import partial
from pathlib import Path

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.imports import Imported, ImportOrigin, check_serial, provenance, read_and_fit
from calrig.analysis.joint_model import is_model_of, joint_of_rest
from calrig.analysis.results import refitted
from calrig.analysis.revisions import Issuer
from calrig.analysis.stored_runs import checked_reason, counted_poses, ended_run, stored_run
from calrig.analysis.unit_of_work import Fits, in_one_transaction
from calrig.export.csv_errors import CsvError
from calrig.model.plan import CALIBRATING
from calrig.run_ids import short_name
from calrig.store import Run, Store
from calrig.store.records import Document

MOST_NOTES = 50_000
"""Characters."""


class Records:
    """Imports and amendments in a store."""

    def __init__(self, store: Store, issuer: Issuer | None = None) -> None:
        self._store = store
        self._issuer = issuer or Issuer(store)

    def import_poses(
        self,
        *,
        unit: str,
        rig: str | None,
        file_name: str,
        content: bytes,
        origin: ImportOrigin | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Run:
        """Makes a completed run of a CSV of poses (CONTRACT section 4); `progress` as of `read_and_fit`.

        `origin` is that of the rig with its reference; None if no reference but the file's is known.

        Raises:
            Invalid: the serial is out of bounds or the file is bad; the message names line and column, and
                nothing is stored.
        """
        origin = origin or ImportOrigin(rig)
        try:
            imported = self.question(unit, origin, content)(progress=progress)
        except CsvError as error:
            raise Invalid(f"{file_name}: {error}") from error
        return self.keep_imported(imported, unit=unit, rig=rig, file_name=file_name, operator=None)

    def question(self, unit: str, origin: ImportOrigin, content: bytes | Path) -> Callable[..., Imported]:
        """What reads and fits a file of poses, here or in another process, or raises CsvError.

        It takes `progress`, as of `read_and_fit`.

        Raises:
            Invalid: the serial is out of bounds.
        """
        check_serial(unit)
        return partial(read_and_fit, content, unit, origin, self._store.effects.in_force(unit, origin.rig))

    def keep_imported(
        self, imported: Imported, *, unit: str, rig: str | None, file_name: str, operator: str | None
    ) -> Run:
        """Makes a completed run of what was read; all of it is stored, or nothing."""
        return self._store.runs.create(
            who=operator,
            unit=unit,
            rig=rig,
            plan=None,
            status="completed",
            poses=imported.poses,
            operator=operator,
            provenance={
                **provenance(operator),
                **imported.origin,
                "imported_from": file_name,
                "mount_axis": imported.mount_axis,
                "warnings": imported.warnings,
            },
            result=None if imported.result is None else imported.result.to_dict(),
            draft=self._issuer.importing(imported, by=operator),
        )

    def void(self, run_id: str, reason: str, *, who: str | None = None) -> Run:
        """Takes an ended run out of every comparison, and its effects out of force; it stays.

        Raises:
            Conflict: what is accepted from the unit's other runs cannot be fitted together without it.
        """
        why = checked_reason(reason)

        def change(fits: Fits) -> Run:
            ended_run(self._store, run_id)
            run = self._store.amendments.void(run_id, why, who=who)
            self.refit_effects(run, fits)
            return self._done(run, who, f"run {short_name(run_id)} was voided: {why}")

        return in_one_transaction(self._store, change)

    def unvoid(self, run_id: str, reason: str, *, who: str | None = None) -> Run:
        """Has a voided run count again.

        Raises:
            Conflict: its effects cannot be fitted together with those in force.
        """
        why = checked_reason(reason)

        def change(fits: Fits) -> Run:
            stored_run(self._store, run_id)
            run = self._store.amendments.unvoid(run_id, why, who=who)
            self.refit_effects(run, fits)
            return self._done(run, who, f"run {short_name(run_id)} counts again: {why}")

        return in_one_transaction(self._store, change)

    def refit_effects(self, run: Run, fits: Fits) -> None:
        """Put the model in force of what is accepted from those runs of a unit that are valid now.

        Raises:
            Conflict: that cannot be fitted together.
        """
        effects = self._store.effects
        before = [one for one in effects.in_force(run.unit, None) if one.is_joint]
        accepted = effects.acceptances(run.unit)
        if before and is_model_of(self._store, before, accepted):
            return
        now = joint_of_rest(self._store, accepted, fits)
        if now != before:  # a model that is put in force once more would outdate every document of it
            effects.replace_joint(run.unit, now)

    def note(self, run_id: str, note: str, *, who: str | None = None) -> Run:
        """Adds to what is noted of a run, at any time."""
        run = stored_run(self._store, run_id)
        if not note.strip():
            raise Invalid("a note says something", ["note"])
        n = len(run.note or "") + len(note)
        if n > MOST_NOTES:
            raise Invalid(f"the notes of run {run_id} would have {n} characters, and {MOST_NOTES} are kept")
        return self._store.amendments.add_note(run_id, note.strip(), who=who)

    def move(self, run_id: str, unit: str, reason: str, *, who: str | None = None) -> Run:
        """Gives a run to the unit it is of, where its serial number was wrong.

        What it follows on and what follows on it was measured of the same unit, and moves along.

        Raises:
            Unknown: there is no such run.
            Invalid: the serial is out of bounds, or there is no reason.
            Conflict: a run goes on, verified the calibration of the unit it was taken for, or shares a
                diagnosis with runs that stay.
            Refused: an effect that was accepted from one is in force.
        """
        check_serial(unit)
        why = checked_reason(reason)
        with self._store.transaction():
            run = ended_run(self._store, run_id)
            if run.unit == unit:
                raise Conflict(f"run {run_id} is of unit {unit!r} already")
            of_unit, _ = self._store.runs.page(unit=run.unit, limit=2**31)
            moving = [ended_run(self._store, one) for one in _chain(run_id, of_unit)]
            for one in moving:
                _check_movable(one, {m.id for m in moving}, of_unit)
            results = {one.id: self._result_for(one, unit) for one in moving}
            self._store.amendments.move(results, unit, why, who=who)
            for one in moving:
                said = f"run {short_name(one.id)} was moved from unit {one.unit} to unit {unit}: {why}"
                self._done(one, who, said)
                self._done(stored_run(self._store, one.id), who, said)
            return stored_run(self._store, run_id)

    def _result_for(self, run: Run, unit: str) -> Document | None:
        """The result that a run has as one of another unit, with what is accepted for that."""
        if run.result is None:
            return None
        return refitted(
            self._store, run.model_copy(update={"unit": unit}), counted_poses(self._store, run.id)
        ).to_dict()

    def exclude_pose(self, run_id: str, index: int, reason: str, *, who: str | None = None) -> Run:
        """Takes one pose out of an ended run's result, which is computed again; the pose stays."""
        why = checked_reason(reason)
        with self._store.transaction():
            result = self._result_of(run_id, index, counts=False)
            run = self._store.amendments.exclude_pose(run_id, index, why, result=result, who=who)
            return self._done(run, who, f"pose {index} of run {short_name(run_id)} was excluded: {why}")

    def include_pose(
        self, run_id: str, index: int, reason: str | None = None, *, who: str | None = None
    ) -> Run:
        """Has an excluded pose count again in the result, which is computed again."""
        why = None if reason is None else checked_reason(reason)
        said = f"pose {index} of run {short_name(run_id)} counts again"
        with self._store.transaction():
            result = self._result_of(run_id, index, counts=True)
            run = self._store.amendments.include_pose(run_id, index, why, result=result, who=who)
            return self._done(run, who, said if why is None else f"{said}: {why}")

    def _result_of(self, run_id: str, index: int, *, counts: bool) -> Document | None:
        """The result of an ended run once one of its poses counts, or does not."""
        run = ended_run(self._store, run_id)
        poses = self._store.poses.of(run_id)
        if index not in {stored.index for stored in poses}:
            raise Unknown(f"run {run_id} has no pose {index}")
        if run.result is None:
            return None
        if run.kind not in CALIBRATING:
            raise Conflict(f"run {run_id} is a {run.kind}: it fits nothing that a pose could be taken out of")
        left = [p.pose for p in poses if (counts if p.index == index else p.excluded is None)]
        if not left:
            raise Conflict(f"pose {index} is the last one that run {run_id} rests on: void the run instead")
        return refitted(self._store, run, left).to_dict()

    def _done(self, run: Run, who: str | None, why: str) -> Run:
        """The run, with the doubts of its unit's next draft, made where that rests on what has been done."""
        self._issuer.redraft(run, by=who, reason=why)
        return stored_run(self._store, run.id)


def _chain(run_id: str, of_unit: Sequence[Run]) -> list[str]:
    """A run, those it follows on and those that follow on it, by whatever way; the oldest first.

    `of_unit` are all of its unit, the newest first.
    """
    near: dict[str, set[str]] = {run.id: set() for run in of_unit}
    for run in of_unit:
        if run.follows in near:
            near[run.id].add(run.follows)
            near[run.follows].add(run.id)
    found, fresh = {run_id}, {run_id}
    while fresh:
        fresh = set().union(*(near[one] for one in fresh)) - found
        found |= fresh
    return [run.id for run in reversed(of_unit) if run.id in found]


def _check_movable(run: Run, moving: Set[str], of_unit: Sequence[Run]) -> None:
    if run.kind == "verification" and run.result is not None:
        raise Conflict(
            f"run {run.id} is a verification: its result is what the calibration of unit {run.unit!r} left; "
            "void it, and verify the right unit"
        )
    for other in of_unit:
        together = (other.diagnosis or {}).get("runs", ())
        stay = [one for one in dict.fromkeys((*together, other.id)) if one not in moving]
        if run.id in together and stay:
            stays = ", ".join(stay)
            raise Conflict(
                f"the diagnosis of run {other.id} is of run {run.id} and of others that stay with unit "
                f"{run.unit!r} ({stays}): diagnose run {other.id} alone first"
            )
