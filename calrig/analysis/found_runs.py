"""Runs that somebody looks for, by their verdict as well."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from calrig.store import Run, Store
from calrig.store.run_search import Sought

Judged = Literal[
    "pass", "conditional_pass", "conditional_fail", "fail", "no_limits", "noise", "more_than_noise"
]
"""A verdict's `answer`, or its `left`."""
MOST_JUDGED = 200
"""Verdicts for one page: they follow the limits of today, and so are in no index."""


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
    n_looked_at = limit if judged is None else MOST_JUDGED
    looked_at, next_cursor = store.sought_runs(sought, limit=n_looked_at, cursor=cursor)
    found: list[Run] = []
    for place, run in enumerate(looked_at):
        if judged is None or _is(run, judged):
            found.append(run)
        if len(found) == limit and place < len(looked_at) - 1:
            return FoundRuns(found, run.id, run.created_at)
    return FoundRuns(found, next_cursor, looked_at[-1].created_at if looked_at else None)


def _is(run: Run, judged: Judged) -> bool:
    verdict = run.verdict
    return verdict is not None and judged in {verdict.answer, verdict.left}
