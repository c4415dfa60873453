"""Every rig of every bench at a glance: what it does, what waits for it, what failed, which check is due."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from calrig.centre.bench_rigs import OFFLINE_S, said_outbox
from calrig.model.service import RigState
from calrig.store import Store
from calrig.store.benches import Bench
from calrig.store.records import Document
from calrig.store.rigs import BriefRun, Standing

NOT_RESOLVED = {"failed", "interrupted"}
_STEPS_S = ((60.0, 10.0), (3600.0, 60.0))
"""Ages below the first are told in steps of the second, those above in hours: an answer stays the same, byte
for byte, while there is nothing new."""


def overview(store: Store, rigs: Sequence[RigState], *, now: datetime | None = None) -> list[Document]:
    """Benches by name, each with its rigs as configured; this machine's own rigs on one without a name.

    Args:
        store: of the centre.
        rigs: as the service tells them.
        now: by which a check is overdue; without it this moment.
    """
    now = now or datetime.now(UTC)
    standings = store.rigs.summaries([rig.name for rig in rigs])

    def on(bench: str | None) -> list[Document]:
        return [_rig(rig, standings[rig.name], now) for rig in rigs if rig.bench == bench]

    here = on(None)
    benches = [{**_bench(bench), "rigs": on(bench.name)} for bench in store.benches.all()]
    return [*([{**_HERE, "rigs": here}] if here else []), *benches]


_HERE: Document = {
    "name": None,
    "hall": None,
    "state": "in_touch",
    "silent_since": None,
    "silent_for_s": None,
    "undelivered": None,
}


def _bench(bench: Bench) -> Document:
    ago_s = bench.seen_ago_s
    is_silent = ago_s is not None and ago_s > OFFLINE_S
    outbox = said_outbox(bench)
    return {
        "name": bench.name,
        "hall": bench.hall,
        "state": "never_seen" if ago_s is None else "silent" if is_silent else "in_touch",
        "silent_since": bench.last_seen_at if is_silent else None,
        "silent_for_s": _coarse(ago_s) if ago_s is not None and is_silent else None,
        "undelivered": outbox.model_dump() if outbox is not None and outbox.parcels else None,
    }


def _coarse(seconds: float) -> float:
    step_s = next((step for below, step in _STEPS_S if seconds < below), 3600.0)
    return seconds // step_s * step_s


def _rig(rig: RigState, standing: Standing, now: datetime) -> Document:
    begun = [run for run in standing.unfinished if run.id == rig.run_id]
    check, last = standing.check, standing.last
    has_failed = last is not None and last.status in NOT_RESOLVED and not last.is_voided
    shown = rig.model_dump()
    for of_bench in ("bench", "hall", "last_seen_at", "clamp"):
        del shown[of_bench]
    return {
        **shown,
        "run": _run(begun[0]) if begun else None,
        "queued": [_run(run) for run in standing.unfinished if run.id != rig.run_id],
        "unresolved": _run(last) if has_failed and last is not None else None,
        "check": None if check is None else {**asdict(check), "overdue": check.due_at < now},
    }


def _run(run: BriefRun) -> Document:
    told: dict[str, Any] = asdict(run)
    del told["is_voided"]
    progress = dict(told.pop("progress"))
    return {**told, "progress": progress, "waiting_for": progress.get("waiting_for")}
