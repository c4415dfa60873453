"""Use cases of a search for runs: pages of them, also by verdict, and times as people write them."""

from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Literal

from calrig.analysis.check_standard import with_doubts
from calrig.analysis.errors import Invalid
from calrig.store import Store
from calrig.store.errors import StoreError
from calrig.store.runs import Sought
from calrig.store.verdicts import Judged, RunPage


def found_runs(
    store: Store, sought: Sought, judged: Judged | None, limit: int, cursor: str | None
) -> RunPage:
    """Return a page of runs as `Store.runs.search` does; with a verdict a short page need not be the last.

    Raises:
        Invalid: the cursor is not one that a page gave.
    """
    try:
        if judged is None:
            items, next_cursor = store.runs.search(sought, limit=limit, cursor=cursor)
            found = RunPage(items, next_cursor, items[-1].created_at if items else None)
        else:
            found = store.verdicts.judged_runs(sought, judged, limit=limit, cursor=cursor)
    except ValueError as error:
        raise Invalid(str(error)) from error
    if found.judged_whole:
        with suppress(StoreError):  # it only makes the next search faster
            store.verdicts.judge(found.judged_whole)
    return replace(found, items=with_doubts(store, found.items))


def moment_of(said: str | None, name: Literal["from", "to"]) -> datetime | None:
    """Return a time in UTC; a time without a zone is UTC's, a day begins with `from` and ends with `to`.

    Raises:
        Invalid: it is neither a day nor a time.
    """
    if said is None:
        return None
    try:
        at = datetime.fromisoformat(said)
        if len(said) == len("2026-11-22") and name == "to":
            at += timedelta(days=1)
        return at.astimezone(UTC) if at.tzinfo else at.replace(tzinfo=UTC)
    except (ValueError, OverflowError) as error:
        raise Invalid(f"{name}: {said[:40]!r} is neither a day nor a time (ISO 8601)", [name]) from error
