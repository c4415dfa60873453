"""The trail: who did what, when and why."""

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import AwareDatetime, Field

from calrig.api.access import Who
from calrig.api.context import Context
from calrig.api.models import Body
from calrig.api.routes import answers
from calrig.model.base import Model
from calrig.store.trail import What

router = APIRouter(tags=["access"])


class EntryAnswer(Model):
    """Something that was done; `who` is null where nobody was known by name."""

    seq: int
    at: datetime
    who: str | None
    what: What
    unit: str | None
    rig: str | None
    run_id: str | None
    revision: int | None
    reason: str | None
    detail: dict[str, Any]
    sha256: str = Field(description="Of the entry before it and all that this one says.")


class TrailAnswer(Model):
    """Entries, and whether the whole trail is as it was written."""

    entries: list[EntryAnswer]
    intact: bool
    broken_at: int | None = Field(description="The first entry that is not what followed on the one before.")


class Backup(Body):
    """The newest entry of the trail in a backup."""

    seq: Annotated[int, Field(ge=0, lt=2**63)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


@router.post(
    "/api/trail/backups",
    **answers(EntryAnswer, "Enter that a backup was made", 409, 413, 422, role="operator", status=201),
)
def enter_backup(body: Backup, context: Context, who: Who) -> object:
    """`calrig backup` does so for the copy that it has made: the trail then has the heads of its backups."""
    return context.store.trail.add_backup(body.seq, body.sha256, who)


@router.get("/api/trail", **answers(TrailAnswer, "Who did what", 422))
def show_trail(
    context: Context,
    unit: str | None = None,
    what: Annotated[list[What] | None, Query()] = None,
    since: AwareDatetime | None = None,
    after: Annotated[int | None, Query(ge=0, lt=2**63)] = None,
    *,
    newest_first: bool = False,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> object:
    """Oldest first, or newest; `after` is the `seq` of the last entry seen, in the same order.

    Of a unit are its runs' entries, and those of runs that were moved away from it.
    """
    entries = context.store.trail.entries(
        unit=unit, what=what or (), since=since, after=after, newest_first=newest_first, limit=limit
    )
    broken_at = context.store.trail.broken_link()
    return {"entries": entries, "intact": broken_at is None, "broken_at": broken_at}
