"""The states of a run and the moves between them that are allowed."""

from __future__ import annotations

from calrig.runs.errors import Conflict

TERMINAL = frozenset({"completed", "failed", "aborted", "interrupted"})

ALLOWED: dict[str, frozenset[str]] = {
    "queued": frozenset({"running", "failed", "aborted", "interrupted"}),
    "running": frozenset({"paused", "completed", "failed", "aborted", "interrupted"}),
    "paused": frozenset({"running", "failed", "aborted", "interrupted"}),
    "completed": frozenset(),
    "failed": frozenset(),
    "aborted": frozenset(),
    "interrupted": frozenset(),
}


def check_transition(run_id: str, before: str, after: str) -> None:
    """Raises Conflict where a run may not go from `before` to `after`."""
    if after not in ALLOWED[before]:
        raise Conflict(f"run {run_id} is {before} and cannot become {after}")
