"""Accepted effects of units and rigs, inside a transaction that the store has begun."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlmodel import Session, col, or_, select

from calrig.store import runs
from calrig.store.records import AcceptedEffect, Document
from calrig.store.tables import AcceptedEffectTable


def accept(session: Session, run_id: str, effects: Sequence[AcceptedEffect]) -> None:
    """As `Store.accept_effects`."""
    row = runs.row_of(session, run_id)
    now = datetime.now(UTC)
    if row.diagnosis is not None:
        row.diagnosis = _marked(row.diagnosis, effects, now)
    session.add_all(
        AcceptedEffectTable(
            run_id=row.id,
            unit=effect.unit,
            rig=effect.rig,
            name=effect.name,
            origin=effect.origin,
            parameters=effect.parameters,
            accepted_at=now,
        )
        for effect in effects
    )


def _marked(diagnosis: Document, accepted: Sequence[AcceptedEffect], now: datetime) -> Document:
    """The diagnosis, saying when effects of it were accepted: those of that name and with those values."""
    at = now.isoformat().replace("+00:00", "Z")
    marked = []
    for effect in diagnosis["effects"]:
        values = {name: given and given["value"] for name, given in effect["parameters"].items()}
        is_one = any((one.name, one.parameters) == (effect["name"], values) for one in accepted)
        marked.append({**effect, "accepted_at": at} if is_one else effect)
    return {**diagnosis, "effects": marked}


def in_force(session: Session, unit: str, rig: str | None) -> list[AcceptedEffect]:
    """As `Store.effects_in_force`."""
    wanted = (
        select(AcceptedEffectTable)
        .where(or_(AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.rig) == (rig or "")))
        .order_by(col(AcceptedEffectTable.id))
    )
    latest: dict[tuple[str | None, str], AcceptedEffect] = {}
    for row in session.exec(wanted):
        latest[row.unit, row.name] = AcceptedEffect(
            run_id=str(row.run_id),
            unit=row.unit,
            rig=row.rig,
            name=row.name,
            origin=row.origin,
            parameters=row.parameters,
        )
    return list(latest.values())


def names(session: Session) -> dict[str, list[str]]:
    """As `Store.effect_names`."""
    wanted = (
        select(AcceptedEffectTable.unit, AcceptedEffectTable.name)
        .where(col(AcceptedEffectTable.unit).is_not(None))
        .distinct()
        .order_by(col(AcceptedEffectTable.unit), col(AcceptedEffectTable.name))
    )
    found: dict[str, list[str]] = {}
    for unit, name in session.exec(wanted):
        found.setdefault(str(unit), []).append(name)
    return found
