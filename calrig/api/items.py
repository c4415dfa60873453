"""What the customer said of a unit, and how it came: for its certificates."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import date
from typing import Annotated, Literal
from unicodedata import category

from fastapi import APIRouter
from pydantic import Field, field_validator

from calrig.api.callers import Who, requires
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import Answer, Body
from calrig.store.items import Item

router = APIRouter(tags=["units"])

TURNS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows them."""
Words = Annotated[str, Field(min_length=1, max_length=500)]
ItemField = Literal[
    "customer", "address", "order", "received_at", "condition", "description", "interval_agreed_months"
]


class ItemBody(Body):
    """A unit as it was handed in; what is left out is not stated on its certificates.

    `supplied` names the fields that are the customer's own word; `interval_agreed_months` is for where the
    customer agreed to an interval.
    """

    customer: Words | None = None
    address: Words | None = None
    order: Words | None = None
    received_at: date | None = None
    condition: Words | None = None
    description: Words | None = None
    interval_agreed_months: Annotated[int, Field(ge=1, le=600)] | None = None
    supplied: Annotated[tuple[ItemField, ...], Field(max_length=7)] = ()

    @field_validator("customer", "address", "order", "condition", "description")
    @classmethod
    def _can_be_printed(cls, value: str | None) -> str | None:
        for character in (value or "").replace("\n", ""):
            if category(character) == "Cc" or character in TURNS:
                raise ValueError(f"has a character in it that cannot be printed: {character!r}")
        return value


class ItemAnswer(Answer):
    """What was said of a unit last; null where nobody has said."""

    customer: str | None
    address: str | None
    order: str | None
    received_at: date | None
    condition: str | None
    description: str | None
    interval_agreed_months: int | None
    supplied: list[ItemField]


@router.get(
    "/api/units/{serial:path}/item",
    response_model=ItemAnswer,
    responses=problems(404),
    summary="How a unit was handed in",
)
def show_item(unit: KnownUnit, context: Context) -> object:
    """What certificates of calibrations made from now on state of it."""
    return context.store.item(unit.serial) or Item()


@router.put(
    "/api/units/{serial:path}/item",
    dependencies=[requires("operator")],
    response_model=ItemAnswer,
    responses=problems(404, 413, 422),
    summary="Say how a unit was handed in",
)
def put_item(unit: KnownUnit, body: ItemBody, context: Context, who: Who) -> object:
    """All of it at once. Certificates of runs before `received_at` keep what was said before."""
    said = Item(**{**body.model_dump(), "supplied": tuple(dict.fromkeys(body.supplied))})
    context.store.say_item(unit.serial, said, who=who)
    return said
