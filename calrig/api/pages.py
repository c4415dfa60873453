"""The page and what it needs: its own files, and plotly's JavaScript out of plotly's wheel."""

# No `from __future__ import annotations`: FastAPI reads the annotations of functions in here.

from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

REVALIDATE = {"Cache-Control": "no-cache"}
KEEP = {"Cache-Control": "public, max-age=31536000, immutable"}


class _PageFiles(StaticFiles):
    """The page's files, which a browser may keep but asks about each time: an update shows at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers.update(REVALIDATE)
        return response


def install(app: FastAPI, web: Path) -> None:
    """Serves `/`, `/web/…` and `/vendor/plotly.min.js`.

    Args:
        app: where to add the paths; the API's own must be there already.
        web: the folder of the page, with `index.html`.
    """
    router = APIRouter(include_in_schema=False)
    plotly = _plotly_javascript()
    plotly_version = version("plotly")

    @router.get("/")
    def index(request: Request) -> Response:
        return _file(web / "index.html", request, REVALIDATE)

    @router.get("/vendor/plotly.min.js")
    def plotly_js(request: Request, v: str | None = None) -> Response:
        """For ever where the address names the version that is installed, else checked each time."""
        return _file(plotly, request, KEEP if v == plotly_version else REVALIDATE)

    app.include_router(router)
    app.mount("/web", _PageFiles(directory=web, check_dir=False), name="web")


def _file(path: Path, request: Request, headers: dict[str, str]) -> Response:
    """The file, or 304 where the browser has it as it is."""
    response = StaticFiles(directory=path.parent).file_response(path, path.stat(), request.scope)
    response.headers.update(headers)
    return response


def _plotly_javascript() -> Path:
    """Where the wheel keeps its script; importing plotly to ask would cost a second of start-up."""
    spec: Any = find_spec("plotly")
    return Path(spec.submodule_search_locations[0]) / "package_data" / "plotly.min.js"
