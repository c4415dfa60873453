"""Every rig of every bench at once: one look into the store for all pages that ask every other second."""

import gzip
import hashlib
from datetime import datetime
from functools import partial
from typing import Annotated, Literal, NamedTuple

from fastapi import APIRouter, Header, Query
from fastapi.responses import Response
from pydantic import Field, TypeAdapter

from calrig.api.context import ApiContext, Context
from calrig.api.routes import answers
from calrig.centre.bench_rigs import overview
from calrig.model.base import Model
from calrig.model.run import Mount, Progress, Status

FRESH_S = 1.0
"""How old what a watcher gets may be."""
DUE_FRESH_S = 60.0
"""Units come due by the day, and whether they have takes a look at all histories."""

router = APIRouter(tags=["benches"])


class BriefRunAnswer(Model):
    """A run as far as a list of rigs shows it."""

    id: str
    unit: str
    kind: str
    status: Status
    progress: Progress
    waiting_for: Mount | None
    created_at: datetime
    finished_at: datetime | None
    error: str | None


class NextCheckAnswer(Model):
    """When the rig's check unit is to be put on it again."""

    unit: str
    due_at: datetime
    overdue: bool


class RigAtAGlance(Model):
    """A rig as `GET /api/rigs` has it, and what is to be known of it beside.

    `state` and `run_id` are those last known where it is `offline`. `unresolved` is the run made last, where
    that failed or was interrupted and nobody has resumed it, begun another one or voided it.
    """

    name: str
    stage: str
    imu: str
    simulated: bool
    state: Literal["idle", "busy", "unreachable", "offline"]
    run_id: str | None
    stop_asked_at: datetime | None
    run: BriefRunAnswer | None = Field(description="Null also of a run that its bench has not delivered yet.")
    queued: list[BriefRunAnswer] = Field(description="What waits for it, the oldest first.")
    unresolved: BriefRunAnswer | None
    check: NextCheckAnswer | None


class UndeliveredAnswer(Model):
    """What a bench has measured and not delivered, as it last said: pieces, and since when."""

    parcels: int
    oldest_at: datetime | None


class BenchAtAGlance(Model):
    """A bench and its rigs; this machine where there is no name.

    `silent_since` is when it last said something, once that is more than ten seconds ago. `silent_for_s` is
    how long ago, in steps that grow with it. `refused` says why it takes no orders, `clock` what is wrong
    with its clock.
    """

    name: str | None
    hall: str | None
    state: Literal["in_touch", "silent", "never_seen"]
    silent_since: datetime | None
    silent_for_s: float | None
    undelivered: UndeliveredAnswer | None
    refused: str | None
    clock: str | None
    rigs: list[RigAtAGlance]


class OverdueAnswer(Model):
    """A unit that is due to be calibrated."""

    unit: str
    due_at: datetime
    due_method: Literal["interval", "drift"] | None
    due_says: str


class _Seen(NamedTuple):
    """What one look gave, written out and packed once for all."""

    body: bytes
    packed: bytes
    tag: str


_WRITTEN = TypeAdapter(list[BenchAtAGlance])


@router.get(
    "/api/benches/overview",
    response_class=Response,
    responses={
        200: {"model": list[BenchAtAGlance]},
        304: {"description": "Nothing has changed since the `ETag` of `If-None-Match`."},
    },
    summary="Every rig of every bench at a glance",
)
async def show_overview(
    context: Context,
    if_none_match: Annotated[str, Header()] = "",
    accept_encoding: Annotated[str, Header()] = "",
) -> Response:
    """At most a second old: all who watch share one look into the store.

    With the `ETag` of the answer before in `If-None-Match` it is 304 while nothing has changed.
    """
    seen = await context.lately.share("overview", partial(_look, context), FRESH_S)
    headers = {"ETag": seen.tag, "Vary": "Accept-Encoding"}
    if seen.tag in if_none_match:
        return Response(status_code=304, headers=headers)
    if "gzip" in accept_encoding:
        headers["Content-Encoding"] = "gzip"
        return Response(seen.packed, headers=headers, media_type="application/json")
    return Response(seen.body, headers=headers, media_type="application/json")


def _look(context: ApiContext) -> _Seen:
    found = overview(context.store, context.service.rigs())
    body = _WRITTEN.dump_json(_WRITTEN.validate_python(found))
    return _Seen(body, gzip.compress(body, 6, mtime=0), f'"{hashlib.sha256(body).hexdigest()[:16]}"')


@router.get("/api/overdue", **answers(list[OverdueAnswer], "Units that are due to be calibrated"))
async def show_overdue(context: Context, limit: Annotated[int, Query(ge=1, le=500)] = 100) -> object:
    """Those that are overdue for longest first; a minute old at most, more where there are very many runs."""
    return (await overdue_units(context))[:limit]


async def overdue_units(context: ApiContext) -> list[OverdueAnswer]:
    """All of them, looked up at most once a minute, less often where that takes long."""
    return await context.lately.share("overdue", partial(_overdue, context), DUE_FRESH_S)


def _overdue(context: ApiContext) -> list[OverdueAnswer]:
    found = [
        OverdueAnswer(unit=unit, due_at=due.due_at, due_method=due.due_method, due_says=due.due_says)
        for unit, due in context.due_dates().units.items()
        if due.overdue and due.due_at is not None
    ]
    return sorted(found, key=lambda one: (one.due_at, one.unit))
