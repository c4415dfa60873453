"""Poses measured elsewhere: a CSV becomes a run."""

from typing import Annotated

from fastapi import APIRouter, File, Form, UploadFile

from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.limits import UPLOAD_BYTES, Turn, name_of
from calrig.api.models import RunAnswer
from calrig.store import Run

router = APIRouter(tags=["runs"])


@router.post(
    "/api/imports",
    max_body_size=UPLOAD_BYTES,
    status_code=201,
    response_model=RunAnswer,
    responses=problems(408, 413, 422, 503),
    summary="Make a run of a CSV of poses",
)
def import_poses(
    context: Context,
    _turn: Turn,
    file: Annotated[UploadFile, File(description="CONTRACT section 4's CSV")],
    unit: Annotated[str, Form()],
    rig: Annotated[str | None, Form()] = None,
    operator: Annotated[str | None, Form(max_length=200)] = None,
) -> Run:
    """A bad file is 422, names line and column, and stores nothing."""
    return context.records.import_poses(
        unit=unit,
        rig=rig or None,
        file_name=name_of(file),
        content=file.file.read(),
        operator=operator,
    )
