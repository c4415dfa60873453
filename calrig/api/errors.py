"""Every error as `{"detail": reason}`, the reason one line that a person can act on."""

import logging
from collections.abc import Sequence
from tempfile import gettempdir
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse

from calrig.analysis.errors import Conflict, Invalid, RunsError, Unknown
from calrig.api.origin_check import HEADERS, NOT_KEPT
from calrig.invalid_fields import SHOWN, in_words, path_of
from calrig.processes.pool import WorkError, WorkLost, WorkRefused, WorkTooLarge
from calrig.store.errors import NotFound, NotText, Refused, StoreError, StoreUnavailableError

log = logging.getLogger(__name__)

FIELDS = "Calrig-Fields"
"""The header of a refusal with the places that are wrong, percent-encoded: `plan.elevations_deg[1]`."""

STATUS: dict[type[Exception], int] = {
    Unknown: 404,
    Conflict: 409,
    Invalid: 422,
    NotFound: 404,
    Refused: 409,
    NotText: 422,
    StoreUnavailableError: 503,
    WorkRefused: 429,
    WorkTooLarge: 422,
    WorkLost: 503,
}

CLIENT_LEFT = 499
"""Nobody hears it but the log."""
DEFECT = "calrig failed inside; the service's log says where"


def install(app: FastAPI) -> None:
    """Has the application answer its errors in the contract's form."""
    for kind in (RunsError, StoreError, WorkRefused, WorkTooLarge, WorkLost):
        app.add_exception_handler(kind, _known_error)
    app.add_exception_handler(Exception, _defect)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(HTTPException, _http_error)


async def _known_error(_request: Request, error: Exception) -> JSONResponse:
    status = status_of(error)
    headers = _naming(error.fields[:SHOWN]) if isinstance(error, RunsError) else {}
    if isinstance(error, WorkRefused | WorkLost):
        headers = {"Retry-After": "5"}
    # Full, locked or read-only is the operator's to mend, and then the same request will do.
    if status >= 500 and not isinstance(error, RunsError):
        log.error("heavy work: %s" if isinstance(error, WorkLost) else "%s", error)
    return JSONResponse({"detail": str(error)}, status, headers)


def _naming(fields: Sequence[str]) -> dict[str, str]:
    """The header that names places in what was sent: the answer's body is `detail` and nothing else."""
    # A name may be empty, `{"": 1}`, and a header of blanks is none that a server may send.
    named = [quote(field, safe="[]._", errors="replace") for field in fields if field]
    return {FIELDS: " ".join(named)} if named else {}


async def _defect(_request: Request, _error: Exception) -> JSONResponse:
    # This answer is given outside of every middleware, the origin check too.
    return JSONResponse({"detail": DEFECT}, 500, HEADERS | NOT_KEPT)


async def _validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)  # noqa: S101 (as registered)
    # pydantic's places begin with where they were looked for: body, query or path
    problems = [{**one, "loc": one["loc"][1:]} for one in error.errors()]
    if problems and problems[0]["type"] == "json_invalid":
        said = f"The body is not JSON: {problems[0].get('ctx', {}).get('error', problems[0]['msg'])}"
        return JSONResponse({"detail": said}, status_code=422)
    named = _naming([path_of(one) for one in problems[:SHOWN]])
    return JSONResponse({"detail": in_words(problems, _body_of(request))}, 422, named)


def _body_of(request: Request) -> object:
    """The type of the body that the path takes; None where it takes none."""
    body = getattr(request.scope.get("route"), "body_field", None)
    return None if body is None else body.field_info.annotation


async def _http_error(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)  # noqa: S101 (as registered)
    # The framework calls a body that it cannot read 400; to the contract it is one more invalid request,
    # unless its client left in the midst of it, or this machine could not lay an upload on its disk.
    if isinstance(error.__cause__, ClientDisconnect):
        return JSONResponse({"detail": "the client left before its request was whole"}, CLIENT_LEFT)
    if error.status_code == 400 and isinstance(error.__cause__, OSError):
        reason = error.__cause__.strerror
        log.error("an upload cannot be laid in %s: %s", gettempdir(), reason)
        return JSONResponse({"detail": no_room(reason)}, status_code=503)
    status = 422 if error.status_code == 400 else error.status_code
    return JSONResponse({"detail": error.detail}, status_code=status, headers=error.headers)


def status_of(error: BaseException) -> int:
    """The status that an answer would have."""
    if isinstance(error, HTTPException):
        return 422 if error.status_code == 400 else error.status_code
    return next((code for kind, code in STATUS.items() if isinstance(error, kind)), 500)


def reason_of(error: BaseException) -> str:
    """What an answer would say of an error, for work whose end no answer tells."""
    if isinstance(error, HTTPException):
        return str(error.detail)
    return str(error) if isinstance(error, RunsError | StoreError | WorkError) else DEFECT


def no_room(reason: str | None) -> str:
    """What is said where an upload cannot be kept until it is read."""
    return f"{gettempdir()}: a file cannot be laid there ({reason}): make room there"
