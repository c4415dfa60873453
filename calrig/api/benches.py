"""Benches of a centre, as an admin keeps them; and how an agent joins by its one-time code.

A bench's own page: it shows everything, starts and stops runs, and leaves the rest to the centre.

What is changed in a bench's spool beside its runs would never reach the centre, which alone amends runs,
issues calibrations and knows people.
"""

from __future__ import annotations

import logging
import re
from dataclasses import asdict
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from calrig.api.access import CLOSE, Who, address_of, is_loopback, requires
from calrig.api.body_limits import ENROLL_PATH, LOGIN_BYTES
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer, Body
from calrig.api.origin_check import HARMLESS
from calrig.store.bench_tables import BENCH_NAME
from calrig.store.enrolment import WrongCode

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.


router = APIRouter(tags=["benches"])
log = logging.getLogger(__name__)


class NewBench(Body):
    """A bench that is to join."""

    name: Annotated[str, Field(pattern=rf"^{BENCH_NAME.pattern}$")]
    hall: Annotated[str, Field(min_length=1, max_length=64)] | None = None


class BenchAnswer(Answer):
    """A bench that may join, has joined or has left."""

    name: str
    hall: str | None
    code_until: datetime | None = Field(
        description="Until when a code waits to be used; null where none does."
    )
    enrolled_at: datetime | None
    revoked_at: datetime | None
    last_seen_at: datetime | None


class BenchWithCode(BenchAnswer):
    """The same, and the code, which is told here and never again."""

    code: str


class Code(Body):
    """What an agent joins by."""

    code: Annotated[str, Field(max_length=200)]


class Joined(Answer):
    """The bench that joined, and the database's URL with its password, told here and never again."""

    bench: str
    db: str


@router.get("/api/benches", response_model=list[BenchAnswer], summary="Every bench, by name")
def list_benches(context: Context) -> object:
    """Those that were revoked as well. What their rigs do is at `/api/rigs`."""
    return [asdict(bench) for bench in context.store.enrolment.benches()]


@router.post(
    "/api/benches",
    status_code=201,
    response_model=BenchWithCode,
    responses=problems(409, 413, 422),
    dependencies=[requires("admin")],
    summary="Let a bench join",
)
def add_bench(body: NewBench, context: Context, who: Who) -> object:
    """By a code for `calrig agent enroll` that works once, within a day; the store keeps its hash.

    Who was revoked, or has not joined yet, gets another one.
    """
    bench, code = context.store.enrolment.add(body.name, body.hall, who=who)
    return {**asdict(bench), "code": code}


@router.post(
    ENROLL_PATH,
    max_body_size=LOGIN_BYTES,
    responses=problems(403, 409, 413, 422, 429),
    summary="Join as a bench",
)
def enroll(body: Code, request: Request, context: Context) -> Joined:
    """Open to whoever has a code. A wrong one is 403, and after five within a minute 429."""
    attempt = context.enrolling.begin(request)
    address = address_of(request)
    try:
        bench, db = context.store.enrolment.enroll(
            body.code,
            host=context.centre.agent_db_host,
            port=context.centre.agent_db_port,
            is_elsewhere=not is_loopback(address),
        )
    except WrongCode as error:
        log.warning("wrong code of a bench from %s", address)
        raise HTTPException(403, str(error)) from error
    context.enrolling.right(attempt)
    log.info("bench %s joined from %s", bench, address)
    return Joined(bench=bench, db=db)


@router.delete(
    "/api/benches/{name}",
    response_model=BenchAnswer,
    responses=problems(404),
    dependencies=[requires("admin")],
    summary="Let a bench in no more",
)
def revoke_bench(name: str, context: Context, who: Who) -> object:
    """Its role can log in no more and its connections end; what it measured stays."""
    return asdict(context.store.enrolment.revoke(name, who=who))


OF_THE_BENCH = re.compile(
    r"/api/(login|logout|runs|runs/[^/]+/(abort|pause|resume)|rigs/scan|rigs/[^/]+/(stop|clamp)|plans/(estimate|design))"
)
"""What a bench does for itself."""
AT_THE_CENTRE = "this is a bench: it starts, stops and shows runs; anything else is changed at its centre"


class BenchPage:
    """ASGI middleware that answers 409 to what only the centre may do."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes on what looks, and what a bench does for itself."""
        asks = scope["type"] == "http" and scope["method"] not in HARMLESS
        if asks and OF_THE_BENCH.fullmatch(scope["path"]) is None:
            refused = JSONResponse({"detail": AT_THE_CENTRE}, 409, CLOSE)
            await refused(scope, receive, send)
            return
        await self.app(scope, receive, send)
