"""The page and what it needs, under addresses that name what they hold: a browser asks for each file once.

`/web/<digest>/main.js` is kept for ever, where the digest is that of all files of the page; only `/`, which
names the digest, is asked about each time. Modules import each other by relative paths and so stay within
one digest. `/web/main.js`, and a digest of before, answer what there is now, to be asked about again.
"""

import hashlib
import re
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, FastAPI, Request
from starlette.responses import HTMLResponse, Response
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Scope

REVALIDATE = {"Cache-Control": "no-cache"}
KEEP = {"Cache-Control": "public, max-age=31536000, immutable"}
DIGITS = 16
_IMPORTED = re.compile(r"""^(?:import|\}) [^()]*?"\./([^"/]+\.js)";""", re.MULTILINE)
_DIGEST = re.compile(rf"^([0-9a-f]{{{DIGITS}}})/")


class _PageFiles(StaticFiles):
    """The page's files, with or without a digest before their names."""

    def __init__(self, web: Path) -> None:
        super().__init__(directory=web, check_dir=False)
        self.web = web

    async def get_response(self, path: str, scope: Scope) -> Response:
        named = _DIGEST.match(path)
        response = await super().get_response(path[named.end() :] if named else path, scope)
        current = named is not None and named[1] == _digest(_files(self.web))
        response.headers.update(KEEP if current else REVALIDATE)
        return response

    def index(self, request: Request) -> Response:
        """`index.html` with today's addresses, its modules among them: no import waits for another."""
        files = _files(self.web)
        digest = _digest(files)
        html = (self.web / "index.html").read_text(encoding="utf-8")
        preloads = [f'<link rel="modulepreload" href="/web/{name}">' for name in _modules(files)]
        html = html.replace("</head>", "\n    ".join([" ", *preloads]) + "\n  </head>")
        headers = {**REVALIDATE, "ETag": f'"{digest}"'}
        response = HTMLResponse(html.replace('"/web/', f'"/web/{digest}/'), headers=headers)
        if self.is_not_modified(response.headers, request.headers):
            return NotModifiedResponse(response.headers)
        return response


def install(app: FastAPI, web: Path) -> None:
    """Serves `/` and `/web/…`.

    The API's own paths must be there already; `web` is the folder of the page, with `index.html`.
    """
    router = APIRouter(include_in_schema=False)
    files = _PageFiles(web)
    router.get("/")(files.index)
    app.include_router(router)
    app.mount("/web", files, name="web")


_Files = tuple[tuple[Path, int, int], ...]
"""Each file with its time of change and its size: while these stay, so does the digest."""


def _files(web: Path) -> _Files:
    found = sorted(path for path in web.rglob("*") if path.is_file())
    return tuple((path, (stat := path.stat()).st_mtime_ns, stat.st_size) for path in found)


@lru_cache(maxsize=4)
def _modules(files: _Files) -> list[str]:
    """The modules that `main.js` imports, and those that they do; not what is imported when it is needed."""
    texts = {path.name: path.read_text(encoding="utf-8") for path, *_ in files if path.suffix == ".js"}
    found, fresh = set[str](), {"main.js"}
    while fresh:
        found |= fresh
        fresh = {name for one in fresh for name in _IMPORTED.findall(texts.get(one, ""))} - found
    return sorted(found)


@lru_cache(maxsize=4)
def _digest(files: _Files) -> str:
    """The first digits of the SHA-256 of all files' names and contents."""
    whole = hashlib.sha256()
    for path, *_ in files:
        whole.update(hashlib.sha256(path.name.encode()).digest() + hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()[:DIGITS]
