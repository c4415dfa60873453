"""The tables of what waits: lists of units for rigs, and the ends of runs that another program is told of."""

# No `from __future__ import annotations`: SQLModel reads the annotations of the classes.

from datetime import datetime
from typing import Any

from sqlmodel import Field, Index, SQLModel

from calrig.store.checksums import CheckedJson
from calrig.store.column_types import UtcText


class BatchTable(SQLModel, table=True):
    """A list of units that are calibrated one after the other; `document` is what holds of all of them."""

    __tablename__ = "batch"
    __table_args__ = (Index("ix_batch_created_at", "created_at"),)

    id: str = Field(primary_key=True)
    created_at: datetime = Field(sa_type=UtcText)
    closed_at: datetime | None = Field(default=None, sa_type=UtcText)
    document: dict[str, Any] = Field(sa_type=CheckedJson)


class BatchUnitTable(SQLModel, table=True):
    """A unit's turn in a list: the rig that it is kept for, and the run that it has got."""

    __tablename__ = "batch_unit"

    batch: str = Field(primary_key=True, foreign_key="batch.id")
    position: int = Field(primary_key=True)
    unit: str
    rig: str | None = None
    run_uid: str | None = None
    state: str
    why: str | None = None


class WebhookDeliveryTable(SQLModel, table=True):
    """The end of a run that another program is to be told of; `due_at` is null once that is over."""

    __tablename__ = "webhook_delivery"
    __table_args__ = (Index("ix_webhook_delivery_due_at", "due_at"),)

    run_uid: str = Field(primary_key=True)
    ended_at: datetime = Field(sa_type=UtcText)
    due_at: datetime | None = Field(default=None, sa_type=UtcText)
    tries: int
    delivered_at: datetime | None = Field(default=None, sa_type=UtcText)
    error: str | None = None
