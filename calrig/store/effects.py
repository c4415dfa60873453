"""Effects that a person accepted: for a unit or for a rig, from the diagnosis of a run."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlmodel import Session, col, or_, select

from calrig.store.convert import iso_utc, run_row
from calrig.store.database import Repository
from calrig.store.errors import Refused
from calrig.store.records import AcceptedEffect, Document
from calrig.store.tables import AcceptedEffectTable, RunTable
from calrig.store.trail import act_on, append

_STANDS = col(AcceptedEffectTable.withdrawn_at).is_(None)
_AT_ONCE = 500
"""Ids in one query."""


class AcceptedEffects(Repository):
    """Accepted effects. A revoked acceptance is kept, and no longer in force."""

    def accept(self, run_id: str, accepted: Sequence[AcceptedEffect], *, who: str | None = None) -> None:
        """Puts effects of a run's diagnosis in force from now on; the diagnosis says since when.

        Each for its unit or its rig, in place of an earlier one of that name.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            run = run_row(session, run_id)
            if run.diagnosis is not None:
                run.diagnosis = _marked(run.diagnosis, accepted, now)
            session.add_all(
                AcceptedEffectTable(
                    run_id=run.id,
                    unit=effect.unit,
                    rig=effect.rig,
                    name=effect.name,
                    origin=effect.origin,
                    parameters=effect.parameters,
                    accepted_at=now,
                )
                for effect in accepted
            )
            append(session, act_on("accepted", run, who, effects=[e.name for e in accepted]), now)

    def revoke(self, run_id: str, names: Sequence[str], reason: str, *, who: str | None = None) -> None:
        """Takes effects that were accepted from a run out of force; what was in force before is so again.

        Raises:
            Refused: one of them was not accepted from this run, or was taken back.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            run = run_row(session, run_id)
            standing = [one for one in accepted_from(session, run) if one.withdrawn_at is None]
            for name in names:
                if name not in {one.name for one in standing}:
                    listed = ", ".join(dict.fromkeys(one.name for one in standing)) or "none"
                    raise Refused(f"{name} is not accepted from run {run_id}; accepted from it: {listed}")
            for one in standing:
                if one.name in names:
                    one.withdrawn_at = now
            if run.diagnosis is not None:
                run.diagnosis = _unmarked(run.diagnosis, names)
            append(session, act_on("taken_back", run, who, reason, effects=list(dict.fromkeys(names))), now)

    def in_force(self, unit: str, rig: str | None) -> list[AcceptedEffect]:
        """The effects accepted for a unit and for a rig: of each name the latest that was not taken back."""
        wanted = (
            select(AcceptedEffectTable, RunTable.uid)
            .join(RunTable)
            .where(or_(AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.rig) == (rig or "")))
            .where(_STANDS)
            .order_by(col(AcceptedEffectTable.id))
        )
        with self._database.reading() as session:
            latest = {(row.unit, row.name): _accepted(row, run_id) for row, run_id in session.exec(wanted)}
        return list(latest.values())

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
            .where(col(AcceptedEffectTable.unit).is_not(None), _STANDS)
            .distinct()
            .order_by(col(AcceptedEffectTable.unit), col(AcceptedEffectTable.name))
        )
        found: dict[str, list[str]] = {}
        with self._database.reading() as session:
            for unit, name in session.exec(wanted):
                found.setdefault(str(unit), []).append(name)
        return found


def _accepted(row: AcceptedEffectTable, run_id: str) -> AcceptedEffect:
    return AcceptedEffect(
        run_id=run_id,
        unit=row.unit,
        rig=row.rig,
        name=row.name,
        origin=row.origin,
        parameters=row.parameters,
        id=row.id,
    )


def _marked(diagnosis: Document, accepted: Sequence[AcceptedEffect], now: datetime) -> Document:
    """The diagnosis, saying when effects of it were accepted: those of that name and with those values."""
    at = iso_utc(now)
    marked = []
    for effect in diagnosis["effects"]:
        values = {name: given and given["value"] for name, given in effect["parameters"].items()}
        is_one = any((one.name, one.parameters) == (effect["name"], values) for one in accepted)
        marked.append({**effect, "accepted_at": at} if is_one else effect)
    return {**diagnosis, "effects": marked}


def _unmarked(diagnosis: Document, names: Sequence[str]) -> Document:
    """The diagnosis without a word of their acceptance."""
    effects = [{**e, "accepted_at": None} if e["name"] in names else e for e in diagnosis["effects"]]
    return {**diagnosis, "effects": effects}


def accepted_from(session: Session, run: RunTable) -> Sequence[AcceptedEffectTable]:
    """Return what was accepted from a run, revoked acceptances included."""
    wanted = select(AcceptedEffectTable).where(AcceptedEffectTable.run_id == run.id)
    return session.exec(wanted.order_by(col(AcceptedEffectTable.id))).all()
