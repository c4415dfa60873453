"""Changes to runs after measurement: voided runs, excluded poses, accepted effects. Each is in the trail."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from sqlalchemy import ColumnElement
from sqlmodel import Session, col, or_, select

from calrig.store.convert import iso_utc, run_of, run_row
from calrig.store.database import Repository
from calrig.store.errors import NotFound, Refused
from calrig.store.records import AcceptedEffect, Document, Run
from calrig.store.runs import replace_result
from calrig.store.tables import AcceptedEffectTable, PoseTable, RunTable, UnitTable
from calrig.store.trail import act_on, append

_STANDS = col(AcceptedEffectTable.withdrawn_at).is_(None), col(RunTable.voided_at).is_(None)
"""Neither revoked nor of a voided run."""
_AT_ONCE = 500
"""Ids in one query."""


class AcceptedEffects(Repository):
    """Accepted effects. A revoked acceptance is kept, and no longer in force.

    Acceptances of several runs are in force as one model, whose effects are stored besides (`is_joint`).
    """

    def accept(
        self,
        run_id: str,
        accepted: Sequence[AcceptedEffect],
        joint: Sequence[AcceptedEffect] = (),
        *,
        who: str | None = None,
    ) -> None:
        """Puts effects of a run's diagnosis in force from now on; the diagnosis says since when.

        Each for its unit or its rig, in place of earlier ones of that name.

        `accepted` are effects as its diagnosis has them, `joint` is the model of these and all earlier
        acceptances of the unit, where there is one.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            run = run_row(session, run_id)
            if run.diagnosis is not None:
                run.diagnosis = _marked(run.diagnosis, accepted, now)
            session.add_all(_row(run.id, effect, now) for effect in accepted)
            if any(one.unit is not None for one in accepted):  # the rig's change no model of the unit
                _replace_joint(session, run.unit, joint, now)
            over = list(joint[0].runs) if joint else [run.uid]
            append(
                session,
                act_on("accepted", run, who, effects=[e.name for e in accepted], fitted_over=over),
                now,
            )

    def revoke(
        self,
        run_id: str,
        names: Sequence[str],
        reason: str,
        joint: Sequence[AcceptedEffect] = (),
        *,
        who: str | None = None,
    ) -> None:
        """Takes effects that were accepted from a run out of force; what was in force before is so again.

        Raises:
            Refused: one of them was not accepted from this run, or was taken back.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            run = run_row(session, run_id)
            standing = [one for one in accepted_from(session, run) if one.withdrawn_at is None]
            standing = [one for one in standing if not _is_joint(one)]
            for name in names:
                if name not in {one.name for one in standing}:
                    listed = ", ".join(dict.fromkeys(one.name for one in standing)) or "none"
                    raise Refused(f"{name} is not accepted from run {run_id}; accepted from it: {listed}")
            for one in standing:
                if one.name in names:
                    one.withdrawn_at = now
            if run.diagnosis is not None:
                found = run.diagnosis["effects"]
                effects = [{**e, "accepted_at": None} if e["name"] in names else e for e in found]
                run.diagnosis = {**run.diagnosis, "effects": effects}
            _replace_joint(session, run.unit, joint, now)
            append(session, act_on("taken_back", run, who, reason, effects=list(dict.fromkeys(names))), now)

    def replace_joint(self, unit: str, joint: Sequence[AcceptedEffect]) -> None:
        """Puts another joint model of a unit's acceptances in force; none where it is empty."""
        with self._database.writing() as session:
            _replace_joint(session, unit, joint, datetime.now(UTC))

    def in_force(self, unit: str, rig: str | None) -> list[AcceptedEffect]:
        """The effects accepted for a unit and for a rig.

        Of each name the latest acceptance that was not taken back, nor is of a voided run; of a unit whose
        acceptances were fitted together, that model alone. The unit's goes before the rig's of one name.
        """
        wanted = or_(AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.rig) == (rig or ""))
        found = self._standing(wanted)
        is_joint = any(first.is_joint for first, *_ in found)
        latest = {
            (one.unit, one.name): together
            for together in found
            if (one := together[0]).unit is None or one.is_joint == is_joint
        }
        # an error is the sensor's or the stage's: what was accepted as the unit's is not the rig's as well
        of_unit = {name for owner, name in latest if owner is not None}
        return [
            effect
            for (owner, name), together in latest.items()
            if owner is not None or name not in of_unit
            for effect in together
        ]

    def acceptances(self, unit: str) -> list[AcceptedEffect]:
        """What was accepted of a unit's runs and has effect, the oldest first; of each run a name's latest.

        Of acceptances that older versions stored, those are left out that a later one of that name replaced.
        """
        standing = self._standing(col(AcceptedEffectTable.unit) == unit)
        found = [together for together in standing if not together[0].is_joint]
        of_name = {together[0].name: together for together in found}
        of_run = {(together[0].run_id, together[0].name): together for together in found}
        return [
            effect
            for (_, name), together in of_run.items()
            if together[0].runs or of_name[name] is together
            for effect in together
        ]

    def _standing(self, wanted: ColumnElement[bool]) -> list[list[AcceptedEffect]]:
        """Acceptances that stand, the oldest first: each with its effects of one name, equal ones once."""
        rows = select(AcceptedEffectTable, RunTable.uid).join(RunTable).where(wanted, *_STANDS)
        found: dict[tuple[object, ...], list[AcceptedEffect]] = {}
        with self._database.reading() as session:
            for row, run_id in session.exec(rows.order_by(col(AcceptedEffectTable.id))):
                key = row.unit, row.rig, row.name, run_id, row.accepted_at, _is_joint(row)
                together, one = found.setdefault(key, []), _accepted(row, run_id)
                together[:] = [*(other for other in together if other.parameters != one.parameters), one]
        return list(found.values())

    def ever_accepted(self, run_id: str) -> list[AcceptedEffect]:
        """Effects that were accepted from a run, the oldest first, those that were taken back since too."""
        with self._database.reading() as session:
            run = run_row(session, run_id)
            rows = accepted_from(session, run)
            return [_accepted(row, run.uid) for row in rows if not _is_joint(row)]

    def by_id(self, ids: Sequence[int]) -> list[AcceptedEffect]:
        """Effects that were accepted, by their ids, those that were taken back since among them."""
        found = []
        with self._database.reading() as session:
            for first in range(0, len(ids), _AT_ONCE):
                some = col(AcceptedEffectTable.id).in_(ids[first : first + _AT_ONCE])
                wanted = select(AcceptedEffectTable, RunTable.uid).join(RunTable).where(some)
                in_order = wanted.order_by(col(AcceptedEffectTable.id))
                found += [_accepted(row, run_id) for row, run_id in session.exec(in_order)]
        return found

    def names_by_unit(self) -> dict[str, list[str]]:
        """Names of the effects in force for each unit that has any."""
        wanted = (
            select(AcceptedEffectTable.unit, AcceptedEffectTable.name)
            .join(RunTable)
            .where(col(AcceptedEffectTable.unit).is_not(None), *_STANDS)
            .distinct()
            .order_by(col(AcceptedEffectTable.unit), col(AcceptedEffectTable.name))
        )
        found: dict[str, list[str]] = {}
        with self._database.reading() as session:
            for unit, name in session.exec(wanted):
                found.setdefault(str(unit), []).append(name)
        return found


def _row(run: int, effect: AcceptedEffect, now: datetime) -> AcceptedEffectTable:
    fit = {
        "runs": list(effect.runs),
        "std": dict(effect.std),
        "factor": {name: list(row) for name, row in effect.factor.items()},
        "run_offset_std_deg": effect.run_offset_std_deg,
        "is_joint": effect.is_joint,
        "is_partial": effect.is_partial,
    }
    said = {name: getattr(effect, name) for name in ("unit", "rig", "name", "origin", "parameters")}
    return AcceptedEffectTable(run_id=run, **said, accepted_at=now, fit=fit if effect.runs else None)


def _replace_joint(session: Session, unit: str, joint: Sequence[AcceptedEffect], now: datetime) -> None:
    wanted = select(AcceptedEffectTable).where(
        AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.withdrawn_at).is_(None)
    )
    for row in session.exec(wanted):
        if _is_joint(row):
            row.withdrawn_at = now
    session.add_all(_row(run_row(session, one.run_id).id, one, now) for one in joint)


def _is_joint(row: AcceptedEffectTable) -> bool:
    return bool((row.fit or {}).get("is_joint"))


def _accepted(row: AcceptedEffectTable, run_id: str) -> AcceptedEffect:
    said = {name: getattr(row, name) for name in ("unit", "rig", "name", "origin", "parameters", "id")}
    return AcceptedEffect(run_id=run_id, **said, **(row.fit or {}))


def _marked(diagnosis: Document, accepted: Sequence[AcceptedEffect], now: datetime) -> Document:
    """The diagnosis, saying when effects of it were accepted: those of that name and with those values."""
    at = iso_utc(now)
    marked = []
    for effect in diagnosis["effects"]:
        values = {name: given and given["value"] for name, given in effect["parameters"].items()}
        is_one = any((one.name, one.parameters) == (effect["name"], values) for one in accepted)
        marked.append({**effect, "accepted_at": at} if is_one else effect)
    return {**diagnosis, "effects": marked}


def accepted_from(session: Session, run: RunTable) -> Sequence[AcceptedEffectTable]:
    """Return what was accepted from a run, revoked acceptances included."""
    wanted = select(AcceptedEffectTable).where(AcceptedEffectTable.run_id == run.id)
    return session.exec(wanted.order_by(col(AcceptedEffectTable.id))).all()


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

        `results` are of each run, with what is in force for that unit.

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

        `result` is what the poses that are left give; a second reason replaces the first.

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
