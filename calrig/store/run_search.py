"""Which runs a person looks for: by what stands in the index that the list is read from, and no fat row."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from sqlalchemy import ColumnElement
from sqlmodel import and_, col, func, or_, select

from calrig.store.tables import RunTable

RunKind = Literal["calibration", "sweep", "verification", "static", "follow-up", "import"]
"""What a run is to a person; a follow-up and an import count as that alone."""
_TOLD = ("sweep", "verification", "static")
"""By the kind of their plan."""

_IMPORTED = select(RunTable.id).where(col(RunTable.plan).is_(None))
_FOLLOW_UPS = select(RunTable.id).where(col(RunTable.follows).is_not(None))


@dataclass(frozen=True, slots=True)
class Sought:
    """What a list of runs is narrowed to; None where it does not matter.

    Attributes:
        unit, rig, status: as they stand there.
        begins: first characters of the UUID.
        text: stands in the serial number or in the note, in capitals or not; % and _ are text.
        since, before: when the run was made: from the first, up to and without the second.
        kind: what it is.
        follows: the run (its id) that it is a follow-up of.
    """

    unit: str | None = None
    rig: str | None = None
    status: str | None = None
    begins: str | None = None
    text: str | None = None
    since: datetime | None = None
    before: datetime | None = None
    kind: RunKind | None = None
    follows: str | None = None

    def conditions(self) -> list[ColumnElement[bool]]:
        """What holds of the rows."""
        found = [
            col(column) == value
            for column, value in ((RunTable.unit, self.unit), (RunTable.kind, _stored_kind(self.kind)))
            if value is not None
        ]
        for column, value in ((RunTable.rig, self.rig), (RunTable.status, self.status)):
            if value is not None:
                # by an index of its own only without a text, which would be looked for row by fat row
                found.append((col(column) if self.text is None else func.coalesce(column, "")) == value)
        if self.begins is not None:
            found.append(beginning(self.begins))
        if self.text is not None:
            texts = (func.lower(RunTable.unit), func.lower(RunTable.note))
            # lowered here: not every PostgreSQL knows the capitals beyond ASCII
            found.append(or_(*(text.contains(self.text.lower(), autoescape=True) for text in texts)))
        if self.since is not None:
            found.append(col(RunTable.created_at) >= self.since)
        if self.before is not None:
            found.append(col(RunTable.created_at) < self.before)
        if self.follows is not None:
            origin = select(RunTable.id).where(RunTable.uid == self.follows)
            found.append(col(RunTable.follows).in_(origin))
        return [*found, *self._of_kind()]

    def _of_kind(self) -> list[ColumnElement[bool]]:
        if self.kind is None:
            return []
        number = col(RunTable.id)
        if self.kind == "import":
            return [number.in_(_IMPORTED)]
        if self.kind == "follow-up":
            return [number.in_(_FOLLOW_UPS)]
        others: list[ColumnElement[bool]] = [number.not_in(_IMPORTED), number.not_in(_FOLLOW_UPS)]
        return [*others, col(RunTable.kind).not_in(_TOLD)] if self.kind == "calibration" else others


def _stored_kind(kind: RunKind | None) -> str | None:
    """The plan's kind, where it tells; the rest of the calibrations are not told apart by it."""
    return kind if kind in _TOLD else None


def beginning(prefix: str) -> ColumnElement[bool]:
    """Of the UUIDs among the ids."""
    uid = col(RunTable.uid)
    return and_(uid.startswith(prefix, autoescape=True), uid.contains("-"))
