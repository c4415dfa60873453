"""What the customer said of a unit: whose it is, when and how it came. Entries are added, none is changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, date, datetime
from typing import Any

from sqlmodel import col, select

from calrig.store.database import Part
from calrig.store.errors import NotFound
from calrig.store.tables import ItemTable, UnitTable
from calrig.store.trail import Act, append


@dataclass(frozen=True, slots=True)
class Item:
    """A unit as it was handed in; None where nobody has said.

    Attributes:
        order: the customer's number.
        condition: in which it came, as seen at receipt.
        interval_agreed_months: until the next calibration, where the customer agreed to one.
        supplied: names of these fields that the customer supplied.
    """

    customer: str | None = None
    address: str | None = None
    order: str | None = None
    received_at: date | None = None
    condition: str | None = None
    description: str | None = None
    interval_agreed_months: int | None = None
    supplied: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        received = None if self.received_at is None else self.received_at.isoformat()
        return {**asdict(self), "received_at": received, "supplied": list(self.supplied)}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Item:
        """What `to_dict` gave."""
        known = {one.name: document[one.name] for one in fields(cls)}
        received = known["received_at"]
        known["received_at"] = None if received is None else date.fromisoformat(received)
        return cls(**{**known, "supplied": tuple(known["supplied"])})


class Items(Part):
    """What was said of units as they came."""

    def item(self, unit: str, day: date | None = None) -> Item | None:
        """What was said of a unit last; with a day, of those received by then. None where nobody did."""
        wanted = select(ItemTable).where(ItemTable.unit == unit).order_by(col(ItemTable.id).desc())
        with self._database.reading() as session:
            said = (Item.from_dict(row.document) for row in session.exec(wanted))
            return next((one for one in said if not _came_after(one, day)), None)

    def say_item(self, unit: str, item: Item, *, who: str | None) -> None:
        """Adds what somebody says of a unit, and puts it into the trail.

        Raises:
            NotFound: there is no such unit.
        """
        with self._database.writing() as session:
            if session.get(UnitTable, unit) is None:
                raise NotFound(f"there is no unit {unit!r}: a unit appears with its first run")
            session.add(ItemTable(unit=unit, document=item.to_dict(), at=datetime.now(UTC)))
            append(session, Act("item_changed", who=who, unit=unit, detail=item.to_dict()))


def _came_after(item: Item, day: date | None) -> bool:
    return day is not None and item.received_at is not None and item.received_at > day
