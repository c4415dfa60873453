"""What is done to runs after they were measured; each act is in the trail by the same transaction."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

from sqlmodel import Session

from calrig.store.convert import run_of, run_row
from calrig.store.database import Repository
from calrig.store.effects import accepted_from
from calrig.store.errors import NotFound, Refused
from calrig.store.records import Document, Run
from calrig.store.runs import replace_result
from calrig.store.tables import PoseTable, RunTable, UnitTable
from calrig.store.trail import act_on, append


class Amendments(Repository):
    """Changes of what counts. Nothing is deleted."""

    def void(self, run_id: str, reason: str, *, who: str | None = None) -> Run:
        """Takes a run out of every comparison; it is kept. A second reason replaces the first."""
        with self._database.writing() as session:
            row = run_row(session, run_id)
            row.voided_reason, row.voided_at = reason, datetime.now(UTC)
            append(session, act_on("voided", row, who, reason))
            return run_of(row)

    def unvoid(self, run_id: str, reason: str, *, who: str | None = None) -> Run:
        """Has a voided run count again.

        Raises:
            Refused: it is not voided.
        """
        with self._database.writing() as session:
            row = run_row(session, run_id)
            if row.voided_at is None:
                raise Refused(f"run {run_id} is not voided")
            append(session, act_on("unvoided", row, who, reason, voided=row.voided_reason))
            row.voided_reason = row.voided_at = None
            return run_of(row)

    def add_note(self, run_id: str, note: str, *, who: str | None = None) -> Run:
        """Adds to what is noted of a run: below what stands there, with the day and who says it."""
        now = datetime.now(UTC)
        with self._database.writing() as session:
            row = run_row(session, run_id)
            head = f"{now:%Y-%m-%d %H:%M} UTC{f', {who}' if who else ''}: "
            row.note = f"{row.note}\n{head}{note}" if row.note else note
            append(session, act_on("noted", row, who, note=note), now)
            return run_of(row)

    def move(
        self, results: Mapping[str, Document | None], unit: str, reason: str, *, who: str | None = None
    ) -> None:
        """Gives runs to another unit, which is made where there is none; all of them or none.

        What was accepted from them and taken back since goes with them.

        Args:
            results: of each run, with what is in force for that unit.
            unit: serial number of the unit they are of.
            reason: why.
            who: does it.

        Raises:
            Refused: an effect that was accepted from one is in force for the unit it was taken for.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            if session.get(UnitTable, unit) is None:
                session.add(UnitTable(serial=unit, created_at=now))
                session.flush()
            for run_id, result in results.items():
                row = run_row(session, run_id)
                for effect in accepted_from(session, row):
                    if effect.unit is not None and effect.withdrawn_at is None:
                        raise Refused(
                            f"{effect.name} was accepted from run {run_id} for unit {effect.unit!r}: "
                            "take it back first"
                        )
                    effect.unit = effect.unit and unit
                moved = {"from": row.unit, "to": unit}
                row.unit = unit
                replace_result(session, row, result)
                append(session, act_on("moved", row, who, reason, **moved), now)

    def exclude_pose(
        self, run_id: str, index: int, reason: str, *, result: Document | None, who: str | None = None
    ) -> Run:
        """Marks a pose as not counting and replaces the run's result; the pose is kept.

        Args:
            run_id: the run.
            index: the pose.
            reason: why it does not count; a second one replaces the first.
            result: what the poses that are left give.
            who: does it.

        Raises:
            NotFound: the run has no such pose.
        """
        with self._database.writing() as session:
            run, pose = _pose(session, run_id, index)
            pose.excluded_reason, pose.excluded_at = reason, datetime.now(UTC)
            replace_result(session, run, result)
            append(session, act_on("excluded", run, who, reason, pose=index))
            return run_of(run)

    def include_pose(
        self, run_id: str, index: int, reason: str | None, *, result: Document | None, who: str | None = None
    ) -> Run:
        """Has an excluded pose count again; as `exclude_pose`.

        Raises:
            NotFound: the run has no such pose.
            Refused: it counts already.
        """
        with self._database.writing() as session:
            run, pose = _pose(session, run_id, index)
            if pose.excluded_at is None:
                raise Refused(f"pose {index} of run {run_id} is not excluded")
            append(session, act_on("included", run, who, reason, pose=index, excluded=pose.excluded_reason))
            pose.excluded_reason = pose.excluded_at = None
            replace_result(session, run, result)
            return run_of(run)


def _pose(session: Session, run_id: str, index: int) -> tuple[RunTable, PoseTable]:
    run = run_row(session, run_id)
    row = session.get(PoseTable, (run.id, index)) if 0 <= index < 2**63 else None
    if row is None:
        raise NotFound(f"run {run_id} has no pose {index}")
    return run, row
