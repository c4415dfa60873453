"""A run's event log as server-sent events: all of it or what follows a known one, then live to its end."""

import asyncio
from collections.abc import AsyncIterator
from functools import partial
from typing import Annotated, NamedTuple

from fastapi import APIRouter, Depends, Header
from fastapi.responses import StreamingResponse
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from pydantic_core import to_json
from starlette.exceptions import HTTPException

from calrig.analysis.stored_runs import stored_run
from calrig.api.context import ApiContext, Context, KnownRun
from calrig.api.routes import answers
from calrig.model.run import AT_REST
from calrig.store import Event

BATCH = 500
"""Events read at once: a long run's log is replayed in pieces, not held in memory whole."""

MOST = 400
"""Streams at once, of all runs: they stay for hours, and other requests need connections too."""
KEEP_ALIVE_S = 12.0
"""How long a stream is silent at most: a comment goes out, so that nothing on the way gives it up."""
UNBUFFERED = {"X-Accel-Buffering": "no"}
"""A proxy shall pass events on as they come."""

LastEventId = Annotated[
    int,
    Header(
        alias="Last-Event-ID",
        ge=0,
        le=2**62,
        description="The last `id` known; what follows it is sent. Anything but a whole number is 422.",
    ),
]


class EventStream(StreamingResponse):
    """An answer in the event-stream format (HTML standard, 9.2).

    Not FastAPI's own class: it takes every event through two queues and a timer, which costs several times
    what the event does, twenty times a second for each browser.
    """

    media_type = "text/event-stream"


AN_EVENT = {
    "type": "object",
    "required": ["data", "event", "id"],
    "properties": {
        "data": {"type": "string", "contentMediaType": "application/json"},
        "event": {"enum": ["state", "progress", "pose", "reading", "move_mismatch"]},
        "id": {"type": "string", "pattern": "^[0-9]+$"},
    },
}

router = APIRouter(tags=["runs"])


async def _news(run: KnownRun, context: Context) -> AsyncIterator[asyncio.Event]:
    """Set whenever the run's log has grown or the service closes; let go when the answer has ended.

    It stands before the first look into the store, so that nothing falls between the two. The store
    alone says what happened, this only that it is worth another look.
    """
    if len(context.streams) >= MOST:
        raise HTTPException(503, f"{MOST} event streams are open: close some", {"Retry-After": "5"})
    with context.streams.joined(context.service.bus, run.id) as news:
        yield news


@router.get(
    "/api/runs/{run_id}/events",
    **answers(
        None,  # with EventStream, the document would call the whole answer one string
        "Server-Sent Events, from the beginning or after `Last-Event-ID`",
        404,
        422,
        sends={EventStream.media_type: {"itemSchema": AN_EVENT}},
    ),
)
async def events(
    run: KnownRun,
    context: Context,
    news: Annotated[asyncio.Event, Depends(_news)],
    last_event_id: LastEventId = 0,
) -> EventStream:
    """Types `state`, `progress`, `pose`, `reading`; `id` is a persisted sequence number.

    Ends after the terminal `state`.
    """
    return EventStream(_follow(context, news, run.id, last_event_id), headers=UNBUFFERED)


async def _follow(context: ApiContext, news: asyncio.Event, run_id: str, known: int) -> AsyncIterator[bytes]:
    """What follows event `known`, written out in pieces of what was there at each look."""
    while not context.streams.closed:
        news.clear()
        look = partial(_look, context, run_id, known)
        seen = await context.streams.looks.share((run_id, known), look)
        if seen.written:
            await context.streams.turns.wait()
            yield seen.written
            known = seen.last
        if seen.has_more:
            continue
        if seen.has_ended:
            return
        try:
            await asyncio.wait_for(news.wait(), KEEP_ALIVE_S)
        except TimeoutError:
            yield KEEPALIVE_COMMENT


class Seen(NamedTuple):
    """What one look into a run's log saw; the number of its last event, 0 where there was none."""

    written: bytes
    last: int
    has_more: bool
    has_ended: bool


def _look(context: ApiContext, run_id: str, known: int) -> Seen:
    """Whether the run had ended is asked before its events are read: then these are the last there are.

    The store is asked, not the service: that may know of an end which the store cannot be told of yet.
    """
    ended = stored_run(context.store, run_id).status in AT_REST
    batch = context.store.events.after(run_id, known, BATCH)
    written = b"".join(_written(event) for event in batch)
    return Seen(written, batch[-1].seq if batch else 0, len(batch) == BATCH, ended)


def _written(event: Event) -> bytes:
    data = to_json(event.data, inf_nan_mode="null").decode()
    return format_sse_event(data_str=data, event=event.type, id=str(event.seq))
