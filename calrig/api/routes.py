"""What a path of the API answers and who may ask, as keyword arguments of FastAPI's decorators."""

from collections.abc import Mapping
from typing import Any

from fastapi.responses import Response

from calrig.api.access import requires
from calrig.api.models import Problem
from calrig.model.service import JobState, Role

WORDS = {
    401: "No token or session was shown, or a wrong one",
    403: "Who asks may not do this; or the request came by a name that is not the service's, or from a page "
    "elsewhere",
    404: "Unknown",
    408: "The body came too slowly",
    409: "The rig is busy, the run's state does not allow this, or the stage was not seen to stand",
    413: "The body is too large",
    422: "Invalid",
    429: "Too many wrong tokens or codes came from there, or too much heavy work is waiting",
    501: "What makes it is not installed",
    503: "The store or the disk is full, the store locked or read-only, too many uploads or event streams "
    "are in hand, or a process was killed",
}
CHANGES = 404, 409, 413, 422
"""Errors of a path that changes something it names."""
UPLOADS = 408, 413, 422, 503
"""Errors of a path that takes a file."""
TEXT = {"schema": {"type": "string"}}
BYTES = {"schema": {"type": "string", "format": "binary"}}
Responses = dict[int | str, dict[str, Any]]
"""Of a path, by status, as FastAPI takes them."""
ACCEPTED: Responses = {
    202: {"model": JobState, "description": "With `wait=false`, after two seconds: `GET /api/jobs/{id}`"}
}


def answers(
    model: Any,
    summary: str,
    *codes: int,
    role: Role | None = None,
    status: int | None = None,
    as_job: bool = False,
    sends: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the keyword arguments of a path's decorator.

    Args:
        model: of the answer; None for one without a body, or whose types are all in `sends`.
        summary: the path's title in the OpenAPI document.
        codes: the errors that it answers, beside those of any path.
        role: the least that its caller must have; None for every caller.
        status: of the answer; None for 200.
        as_job: whether a client need not wait for the answer.
        sends: what the answer may be beside the model, by media type.
    """
    responses = dict(ACCEPTED) if as_job else {}
    if sends is not None:
        responses[200] = {"content": dict(sends)}
    is_json = sends is None or model is not None or "application/json" in sends
    return {
        "response_model": model,
        **({"response_class": Response} if sends is not None and model is None else {}),
        "summary": summary,
        "responses": responses | (problems if is_json else problems_in_json)(*codes),
        "dependencies": [] if role is None else [requires(role)],
        "status_code": status,
    }


def problems(*codes: int) -> Responses:
    """The error answers of a path, for the OpenAPI document."""
    return {code: {"model": Problem, "description": WORDS[code]} for code in codes}


def problems_in_json(*codes: int) -> Responses:
    """The same for a path whose own answers are not JSON: a model would be said to be of their type."""
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {code: {"content": content, "description": WORDS[code]} for code in codes}
