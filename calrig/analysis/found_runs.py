"""Runs that somebody looks for, by their verdict as well."""

from __future__ import annotations

from typing import Literal

from calrig.store import Run, Store
from calrig.store.run_search import Sought

Judged = Literal[
    "pass", "conditional_pass", "conditional_fail", "fail", "no_limits", "noise", "more_than_noise"
]
"""A verdict's `answer`, or its `left`."""
MOST_JUDGED = 200
"""Verdicts for one page: they follow the limits of today, and so are in no index."""


def found_runs(
    store: Store, sought: Sought, judged: Judged | None, limit: int, cursor: str | None
) -> tuple[list[Run], str | None]:
    """A page of runs as of `Store.sought_runs`; with a verdict it may be short, and is not the last for that.

    Raises:
        ValueError: as there.
    """
    if judged is None:
        return store.sought_runs(sought, limit=limit, cursor=cursor)
    looked_at, next_cursor = store.sought_runs(sought, limit=MOST_JUDGED, cursor=cursor)
    found: list[Run] = []
    for place, run in enumerate(looked_at):
        if (verdict := run.verdict) is not None and judged in {verdict.answer, verdict.left}:
            found.append(run)
        if len(found) == limit:
            is_last = next_cursor is None and place == len(looked_at) - 1
            return found, None if is_last else run.id
    return found, next_cursor
