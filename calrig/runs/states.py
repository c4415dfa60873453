"""The moves between the states of a run that are allowed."""

from __future__ import annotations

from calrig.analysis.errors import Conflict
from calrig.store.records import TERMINAL

ALLOWED: dict[str, frozenset[str]] = {
    "queued": frozenset({"running", "failed", "aborted", "interrupted"}),
    "running": frozenset({"paused", "completed", "failed", "aborted", "interrupted"}),
    "paused": frozenset({"running", "failed", "aborted", "interrupted"}),
    "interrupted": frozenset({"queued", "aborted"}),
    **{status: frozenset() for status in TERMINAL},
}


def check_transition(run_id: str, before: str, after: str) -> None:
    """Raises Conflict where a run may not go from `before` to `after`."""
    if after not in ALLOWED[before]:
        raise Conflict(f"run {run_id} is {before} and cannot become {after}")
