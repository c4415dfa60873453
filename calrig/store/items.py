"""What the customer said of a unit: whose it is, when and how it came."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date


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
