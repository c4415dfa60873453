"""Store of runs, poses, events and raw samples in a SQLite file or a PostgreSQL database.

Names are imported when first used: a process for background tasks uses records without loading a database's
libraries, which takes longer than most tasks.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calrig.store.errors import NotFound, StoreDamagedError, StoreError, StoreUnavailableError
    from calrig.store.event_log import Announced
    from calrig.store.records import (
        AcceptedEffect,
        ComparisonRow,
        Event,
        RawSamples,
        Run,
        RunChanges,
        SampleBlock,
        StoredPose,
        StoredStagePosition,
        Unit,
    )
    from calrig.store.rigs import CheckUnit
    from calrig.store.sqlite.backup import BackedUp, back_up
    from calrig.store.store import Store

_ELSEWHERE = {
    "Announced": "event_log",
    "BackedUp": "sqlite.backup",
    "CheckUnit": "rigs",
    "NotFound": "errors",
    "Store": "store",
    "StoreDamagedError": "errors",
    "StoreError": "errors",
    "StoreUnavailableError": "errors",
    "back_up": "sqlite.backup",
}
"""Modules of what is no record."""


def __getattr__(name: str) -> Any:
    module = import_module(f"{__name__}.{_ELSEWHERE.get(name, 'records')}")
    return getattr(module, name)
