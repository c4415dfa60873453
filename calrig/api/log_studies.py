"""Studies of logs that people brought: listed, shown again, removed."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime

from fastapi import APIRouter

from calrig.analysis.errors import Unknown
from calrig.api.callers import requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer
from calrig.api.noise import FiltersAnswer, NoiseAnswer
from calrig.store.log_studies import StudyKind

router = APIRouter(tags=["noise"])


class StudyAnswer(Answer):
    """A study of a file that somebody brought."""

    id: str
    created_at: datetime
    studied_by: str | None
    kind: StudyKind
    file_name: str


class KeptStudy(Answer):
    """One with what was found: `noise` or `filters`, the other is null."""

    study: StudyAnswer
    noise: NoiseAnswer | None
    filters: FiltersAnswer | None


@router.get("/api/log-studies", response_model=list[StudyAnswer], summary="Logs that people brought")
def studies(context: Context) -> object:
    """The latest 200, the newest first; what each found is at its own address."""
    return context.store.studies()


@router.get(
    "/api/log-studies/{study_id}",
    response_model=KeptStudy,
    responses=problems(404),
    summary="What was found in one",
)
def show_study(study_id: str, context: Context) -> object:
    """As it was answered then."""
    kept = context.store.study(study_id)
    if kept is None:
        raise Unknown(f"there is no study {study_id!r}")
    study, found = kept
    answer = {"id": study.id, **found}
    return {"study": study, "noise": None, "filters": None, study.kind: answer}


@router.delete(
    "/api/log-studies/{study_id}",
    dependencies=[requires("operator")],
    status_code=204,
    responses=problems(404),
    summary="Remove one",
)
def remove_study(study_id: str, context: Context) -> None:
    """For good."""
    if not context.store.remove_study(study_id):
        raise Unknown(f"there is no study {study_id!r}")
