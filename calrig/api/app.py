"""The application: every path of the API and the page over one run service."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path

from fastapi import APIRouter, FastAPI
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import Response
from starlette.types import Lifespan

import calrig
from calrig.analysis.due_dates import INTERVAL_DAYS
from calrig.api import (
    batches,
    benches,
    calibrations,
    certificates,
    diagnoses,
    errors,
    events,
    figures,
    imports,
    jobs,
    limits,
    measurements,
    metrics,
    noise,
    overview,
    pages,
    plans,
    rigs,
    runs,
    solve,
    trail,
    units,
    users,
)
from calrig.api.access import TOKEN, Access
from calrig.api.authentication import Authentication, TrustedProxies
from calrig.api.benches import BenchPage
from calrig.api.body_limits import JSON_BYTES, BodyPatience
from calrig.api.context import ApiContext
from calrig.api.origin_check import OriginCheck, RequestLog
from calrig.api.routes import problems_in_json
from calrig.api.streams import FairStartMiddleware
from calrig.laboratory import LaboratorySettings
from calrig.runs.services import Service
from calrig.settings import CentreSettings, packed

PARTS = (
    runs,
    batches,
    plans,
    diagnoses,
    solve,
    events,
    measurements,
    noise,
    figures,
    calibrations,
    certificates,
    units,
    rigs,
    imports,
    jobs,
    limits,
    users,
    benches,
    overview,
    trail,
    metrics,
)
"""Figures before units: `/api/units/{serial:path}` would take their paths for serial numbers."""
EVERYBODY = Access()
DOCUMENT = Path(__file__).parent.parent / "docs" / "openapi.json"
"""Of the paths of the API, as `python -m calrig.api.openapi` writes it."""


def create_app(
    service: Service,
    *,
    web: Path | None = None,
    access: Access = EVERYBODY,
    interval_days: float = INTERVAL_DAYS,
    limits_kept_in: str | None = None,
    is_bench: bool = False,
    centre: CentreSettings | None = None,
    laboratory: LaboratorySettings | None = None,
) -> FastAPI:
    """Makes the application; it shares no state with another one.

    Args:
        service: carries out what is asked. It is closed when the application shuts down.
        web: the folder of the page; without it the one that comes with calrig.
        access: the token that is asked for and the names the service has.
        interval_days: after which a unit is due whose history says nothing.
        limits_kept_in: the file that gives the limits, which then are not changed over HTTP.
        is_bench: whether it is a bench's own page, which leaves to the centre what only that may do.
        centre: how agents reach the database of a centre, where that is not as the centre does.
        laboratory: who issues certificates.
    """

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        await asyncio.to_thread(service.close)  # by no thread of those that answer requests
        await _app.state.context.jobs.close()
        await _app.state.context.processes.close()

    app = api(lifespan)
    app.state.context = ApiContext(
        service,
        service.store,
        limits_kept_in,
        interval_days=interval_days,
        centre=centre or CentreSettings(),
        laboratory=laboratory or LaboratorySettings(),
    )
    app.state.authentication = Authentication(access, service.store.users.all)
    if is_bench:
        app.add_middleware(BenchPage)
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=6)  # event streams never
    app.add_middleware(OriginCheck, app.state.authentication)
    app.add_middleware(RequestLog)
    app.add_middleware(TrustedProxies, access)
    app.add_middleware(FairStartMiddleware)  # the last one added is the first to look
    pages.install(app, packed("web") if web is None else web)
    return app


def what_is_asked(app: FastAPI) -> str:
    """What an application asks of those who speak to it, for the end of a sentence; empty where nothing."""
    authentication: Authentication = app.state.authentication
    if authentication.access.token is not None:
        return f"; it asks for the token of {TOKEN}" + (", or a user's" if authentication.people else "")
    return "; it asks who one is: a user" if authentication.asks else ""


def api(lifespan: Lifespan[FastAPI] | None = None) -> FastAPI:
    """The paths of the API alone, which is all that the OpenAPI document is about."""
    app = FastAPI(
        title="calrig",
        version=calrig.__version__,
        summary="Calibrates IMU attitude sensors on a rotary stage",
        lifespan=lifespan,
        openapi_url=None,  # FastAPI makes it in the event loop, which takes a second: the one kept is sent
        docs_url=None,  # its pages load their scripts from another host
        redoc_url=None,
    )
    app.add_middleware(BodyPatience)
    errors.install(app)
    app.router.routes.extend(_paths().routes)

    @app.get("/api/openapi.json", include_in_schema=False)
    def openapi() -> Response:
        return Response(DOCUMENT.read_bytes(), media_type="application/json")

    return app


@cache
def _paths() -> APIRouter:
    """Return the paths of all parts, shared by all applications: FastAPI takes 0.3 s to prepare them."""
    paths = APIRouter()
    of_any = problems_in_json(401, 403, 408, 413, 422, 429, 503)
    for part in PARTS:
        paths.include_router(part.router, responses=of_any, max_body_size=JSON_BYTES)
    return paths
