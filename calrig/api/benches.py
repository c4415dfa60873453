"""Benches of a centre: added and revoked by an admin, enrolled by a one-time code; and a bench's own page.

That page shows everything and starts and stops runs. Only the centre amends runs, issues calibrations and
knows users: such a change in a bench's spool would never reach it.
"""

import logging
import re
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from calrig.api.access import CLOSE, Who, address_of, is_loopback
from calrig.api.body_limits import ENROLL_PATH, LOGIN_BYTES
from calrig.api.context import Context
from calrig.api.models import Body
from calrig.api.origin_check import HARMLESS
from calrig.api.routes import answers, problems
from calrig.model.base import Model
from calrig.model.service import Membership
from calrig.store.bench_tables import BENCH_NAME
from calrig.store.enrolment import WrongCode

router = APIRouter(tags=["benches"])
log = logging.getLogger(__name__)


class NewBench(Body):
    """A bench that is to join."""

    name: Annotated[str, Field(pattern=rf"^{BENCH_NAME.pattern}$")]
    hall: Annotated[str, Field(min_length=1, max_length=64)] | None = None


class BenchWithCode(Membership):
    """The same, and the code, which is told here and never again."""

    code: str


class Code(Body):
    """What an agent joins by, protocol and schema of its calrig, and the names of its rigs."""

    code: Annotated[str, Field(max_length=200)]
    protocol: Annotated[int, Field(ge=1, le=10**9)] = 1
    schema_revision: Annotated[str, Field(pattern="^[0-9]{4}$")] = "0000"
    rigs: list[Annotated[str, Field(max_length=200)]] = Field(default_factory=list, max_length=1000)


class Joined(Model):
    """The bench that joined, and the database's URL with its password, told here and never again."""

    bench: str
    db: str


@router.get("/api/benches", **answers(list[Membership], "Every bench, by name"))
def list_benches(context: Context) -> object:
    """Those that were revoked as well. What their rigs do is at `/api/rigs`."""
    return context.store.enrolment.benches()


@router.post(
    "/api/benches", **answers(BenchWithCode, "Let a bench join", 409, 413, 422, role="admin", status=201)
)
def add_bench(body: NewBench, context: Context, who: Who) -> object:
    """By a code for `calrig agent enroll` that works once, within a day; the store keeps its hash.

    Who was revoked, or has not joined yet, gets another one.
    """
    bench, code = context.store.enrolment.add(body.name, body.hall, who=who)
    return BenchWithCode(**bench.model_dump(), code=code)


@router.post(
    ENROLL_PATH,
    max_body_size=LOGIN_BYTES,
    responses=problems(403, 409, 413, 422, 429),
    summary="Join as a bench",
)
def enroll(body: Code, request: Request, context: Context) -> Joined:
    """Open to every client with a code. A wrong code gets 403, after five within a minute 429."""
    attempt = context.enrolling.begin(request)
    address = address_of(request)
    try:
        bench, db = context.store.enrolment.enroll(
            body.code,
            host=context.centre.agent_db_host,
            port=context.centre.agent_db_port,
            is_elsewhere=not is_loopback(address),
            protocol=body.protocol,
            schema_revision=body.schema_revision,
            rigs=body.rigs,
        )
    except WrongCode as error:
        log.warning("wrong code of a bench from %s", address)
        raise HTTPException(403, str(error)) from error
    context.enrolling.right(attempt)
    log.info("bench %s joined from %s", bench, address)
    return Joined(bench=bench, db=db)


@router.delete("/api/benches/{name}", **answers(Membership, "Revoke a bench", 404, role="admin"))
def revoke_bench(name: str, context: Context, who: Who) -> object:
    """Blocks the bench's login and closes its connections; data it has measured is kept."""
    return context.store.enrolment.revoke(name, who=who)


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
