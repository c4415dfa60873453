"""A unit's archive over HTTP, made as it is sent."""

# No `from __future__ import annotations`: FastAPI reads the annotations.

import re
from itertools import chain

from fastapi import APIRouter
from fastapi.responses import Response, StreamingResponse

from calrig.analysis.archives import archive_of
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems_in_json

ZIP = "application/zip"

router = APIRouter(tags=["units"])


@router.get(
    "/api/units/{serial:path}/archive",
    response_class=Response,
    responses={
        200: {"content": {ZIP: {"schema": {"type": "string", "format": "binary"}}}},
        **problems_in_json(404),
    },
    summary="All that stands behind a unit's calibrations",
)
def show_archive(unit: KnownUnit, context: Context) -> Response:
    """One zip with every revision, run, pose and sample, and the trail; `calrig verify` checks it."""
    name = re.sub(r"[^A-Za-z0-9._-]", "_", unit.serial)
    headers = {
        "Content-Disposition": f'attachment; filename="archive-{name}.zip"',
        "Content-Encoding": "identity",  # it is packed
    }
    pieces = archive_of(context.store, unit.serial, context.laboratory)
    first = next(pieces)  # what is wrong with the store is told in place of it
    return StreamingResponse(chain([first], pieces), media_type=ZIP, headers=headers)
