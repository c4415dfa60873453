"""Runs, poses, events and raw samples in one SQLite file (SQLModel tables, Alembic migrations)."""

from calrig.store.check_units import CheckUnit
from calrig.store.errors import NotFound, StoreDamagedError, StoreError, StoreUnavailableError
from calrig.store.event_log import Announced
from calrig.store.records import (
    AT_REST,
    AcceptedEffect,
    ComparisonRow,
    Event,
    LeftAt,
    Progress,
    RawSamples,
    Run,
    RunChanges,
    SampleBlock,
    Status,
    StoredPose,
    Unit,
    Voided,
)
from calrig.store.sqlite.backup import BackedUp, back_up
from calrig.store.store import Store

__all__ = [
    "AT_REST",
    "AcceptedEffect",
    "Announced",
    "BackedUp",
    "CheckUnit",
    "ComparisonRow",
    "Event",
    "LeftAt",
    "NotFound",
    "Progress",
    "RawSamples",
    "Run",
    "RunChanges",
    "SampleBlock",
    "Status",
    "Store",
    "StoreDamagedError",
    "StoreError",
    "StoreUnavailableError",
    "StoredPose",
    "Unit",
    "Voided",
    "back_up",
]
