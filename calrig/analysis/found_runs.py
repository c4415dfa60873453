"""Runs that somebody looks for, by their verdict as well."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from calrig.store import Run, Store
from calrig.store.errors import StoreError
from calrig.store.run_search import Sought
from calrig.store.verdicts import Judged


@dataclass(frozen=True, slots=True)
class FoundRuns:
    """A page of runs.

    Attributes:
        items: the newest first.
        next_cursor: of the next page; None after the last.
        back_to: when the oldest run was made that was looked at, found or not; None where there was none.
    """

    items: list[Run]
    next_cursor: str | None
    back_to: datetime | None


def found_runs(
    store: Store, sought: Sought, judged: Judged | None, limit: int, cursor: str | None
) -> FoundRuns:
    """A page of runs as of `Store.sought_runs`; with a verdict it may be short, and is not the last for that.

    Raises:
        ValueError: as there.
    """
    if judged is None:
        items, next_cursor = store.sought_runs(sought, limit=limit, cursor=cursor)
        return FoundRuns(items, next_cursor, items[-1].created_at if items else None)
    found = store.judged_runs(sought, judged, limit=limit, cursor=cursor)
    if found.judged_whole:
        with suppress(StoreError):  # it is for the next search
            store.judge(found.judged_whole)
    return FoundRuns(found.items, found.next_cursor, found.back_to)
