"""Batches: units that are calibrated one after the other, as every tab, phone and reload shows them."""

import hashlib
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Header
from fastapi.responses import Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from calrig.api.access import Who
from calrig.api.context import ApiContext, Context
from calrig.api.jobs import Heavy
from calrig.api.models import Body
from calrig.api.routes import CHANGES, answers, problems
from calrig.model.base import Model
from calrig.model.plan import Plan
from calrig.model.run import Mount, Progress, Status
from calrig.runs.batches import Standing, serials_in, word_of
from calrig.runs.presence import BoardCheck
from calrig.store import Run
from calrig.store.batches import Batch, Turn

LONGEST_CSV = 200_000
Serials = Annotated[list[Annotated[str, Field(max_length=1000)]], Field(max_length=10_000)]


class UnitsBody(Body):
    """Serials, one an entry, or a CSV: its column `unit` or `serial`, else its first."""

    units: Serials = Field(default_factory=list)
    csv: Annotated[str, Field(max_length=LONGEST_CSV)] | None = None

    def serials(self) -> list[str]:
        """All of them, in order."""
        return [*self.units, *(serials_in(self.csv)[0] if self.csv else ())]


class Table(Body):
    """A CSV."""

    csv: Annotated[str, Field(max_length=LONGEST_CSV)]


class SerialsAnswer(Model):
    """The serials of a CSV as they stand there, and how many of its rows have none."""

    units: list[str]
    left_out: int


class MakeBatch(UnitsBody):
    """A list: its units, the rigs side by side that they go to (without any, the first), and how."""

    rigs: Annotated[list[str], Field(max_length=50)] | None = None
    plan: Plan = Plan()
    operator: Annotated[str, Field(max_length=200)] | None = None
    note: Annotated[str, Field(max_length=10_000)] | None = None
    failed: Literal["end", "follow_up"] = Field(
        default="end",
        description="A unit that fails gets another turn at the end, or at once the run that tells why.",
    )


class NameUnit(Body):
    """A unit of the list."""

    unit: str


class StartTurn(Body):
    """What a person has mounted, and where."""

    rig: str
    unit: str
    stage_at_deg: Annotated[float, Field(ge=-360, le=360)] | None = None


class TurnAnswer(Model):
    """A unit's turn. `word`: pass or fail by its limits, `done` without any; null before it was measured."""

    position: int
    unit: str
    state: Literal["waiting", "follow_up", "running", "done", "failed", "removed"]
    rig: str | None
    run_id: str | None
    word: Literal["pass", "fail", "done"] | None
    why: str | None


class SeenAnswer(Model):
    """What was seen of the unit on a rig while nobody uses it.

    `absent`: no board answers; `wrong`: the board says another serial; `askew`: gravity contradicts.
    """

    state: Literal["looking", "absent", "moving", "askew", "wrong", "there"]
    serial: str | None = Field(description="By the board's own word; empty where it has none.")
    says: str


class BatchRigAnswer(Model):
    """A rig of the list. `on` is under way or to be mounted, `next` comes then, `last` ended last.

    `seen` tells of the unit that `on` waits for; null while nobody has asked for a look.
    """

    name: str
    state: Literal["idle", "busy", "unreachable", "offline"]
    busy_with: str | None
    on: TurnAnswer | None
    status: Status | None = Field(description="Of the run under way.")
    progress: Progress | None
    waiting_for: Mount | None
    seen: SeenAnswer | None
    next: TurnAnswer | None
    last: TurnAnswer | None
    last_says: list[str]
    designing: bool = Field(description="Whether the run that tells why is diagnosed for and designed now.")
    nothing_measured: bool = Field(description="By the run that `on` had here after that of `last`.")


class LookAnswer(Model):
    """The rigs of a list as they stand."""

    rigs: list[BatchRigAnswer]


class BatchAnswer(Model):
    """A list as it stands."""

    id: str
    created_at: datetime
    closed_at: datetime | None
    plan: Plan
    operator: str | None
    note: str | None
    failed: Literal["end", "follow_up"]
    rigs: list[BatchRigAnswer]
    units: list[TurnAnswer]
    known: list[str] = Field(description="Of units just added, those that the list had already.")


class ListedBatch(Model):
    """A list among the others; `takes_units` is false of one that is closed, or of another day."""

    id: str
    created_at: datetime
    closed_at: datetime | None
    rigs: list[str]
    operator: str | None
    note: str | None
    takes_units: bool


router = APIRouter(tags=["batches"])


@router.get("/api/batches", **answers(list[ListedBatch], "Batches, the newest first"))
def list_batches(context: Context) -> object:
    """The last twenty."""
    return [
        {**one.document, **_known_by(one), "takes_units": takes_units}
        for one, takes_units in context.batches.listed()
    ]


@router.post(
    "/api/batches", **answers(BatchAnswer, "Create a batch", 404, 413, 422, role="operator", status=201)
)
def make_batch(body: MakeBatch, context: Context, who: Who) -> object:
    """Nothing moves until a person confirms that a unit is mounted. A unit named twice is one batch item."""
    rigs = body.rigs or [context.service.known_rig(None).name]
    made = context.batches.make(
        body.serials(),
        rigs=rigs,
        plan=body.plan,
        failed=body.failed,
        operator=who or body.operator,
        note=body.note,
    )
    return _answer(context, made.id)


@router.post(
    "/api/batches/read",
    **answers(
        SerialsAnswer, "Read the serials of a CSV, before a batch is made of them", 413, 422, role="operator"
    ),
)
def read_serials(body: Table) -> object:
    """Keeps nothing. 422 names the line that is wrong."""
    units, left_out = serials_in(body.csv)
    return SerialsAnswer(units=units, left_out=left_out)


@router.get(
    "/api/batches/{batch_id}",
    response_class=Response,
    responses={
        200: {"model": BatchAnswer},
        304: {"description": "Nothing has changed since the `ETag` of `If-None-Match`."},
        **problems(404),
    },
    summary="A batch and its state",
)
def show_batch(batch_id: str, context: Context, if_none_match: Annotated[str, Header()] = "") -> Response:
    """Asked for again and again by those who watch: 304 while nothing has changed."""
    body = _answer(context, batch_id).model_dump_json().encode()
    tag = f'"{hashlib.sha256(body).hexdigest()[:16]}"'
    if tag in if_none_match:
        return Response(status_code=304, headers={"ETag": tag})
    return Response(body, headers={"ETag": tag}, media_type="application/json")


@router.post(
    "/api/batches/{batch_id}/units",
    **answers(BatchAnswer, "Add units to a batch", *CHANGES, role="operator"),
)
def add_units(batch_id: str, body: UnitsBody, context: Context) -> object:
    """Added at the end. Units of the batch stay where they are and are listed in `known`, unless they failed.

    409 where no unit of the batch was measured for hours.
    """
    known = context.batches.add(batch_id, body.serials())
    return _answer(context, batch_id, known)


@router.post(
    "/api/batches/{batch_id}/remove",
    **answers(BatchAnswer, "Remove a unit from a batch", 404, 409, 422, role="operator"),
)
def remove_unit(batch_id: str, body: NameUnit, context: Context) -> object:
    """One that waits; 409 otherwise."""
    context.batches.remove(batch_id, body.unit)
    return _answer(context, batch_id)


@router.post(
    "/api/batches/{batch_id}/start",
    **answers(BatchAnswer, "Start the run of a mounted unit", 404, 409, 422, role="operator"),
)
async def start_turn(batch_id: str, body: StartTurn, context: Context, heavy: Heavy, who: Who) -> object:
    """409 where the unit does not wait or the rig is busy: of two who ask at once one is refused.

    A board that says another serial fails the run before anything moves, and the unit stays next.
    """

    def begin() -> BatchAnswer:
        start = context.batches.start
        start(batch_id, body.rig, body.unit, heavy.from_thread, who, body.stage_at_deg)
        return _answer(context, batch_id)

    return await run_in_threadpool(begin)


@router.post(
    "/api/batches/{batch_id}/look",
    **answers(LookAnswer, "Check whether the expected units are present", 404, role="operator"),
)
def look(batch_id: str, context: Context) -> object:
    """For six seconds the boards of idle rigs are opened and listened to; nothing moves.

    `seen` of each rig tells what came of it. Whoever watches asks again every few seconds.
    """
    return LookAnswer(rigs=_rigs(context, context.batches.look(batch_id)))


@router.post(
    "/api/batches/{batch_id}/close", **answers(BatchAnswer, "Close a batch", 404, 409, role="operator")
)
def close_batch(batch_id: str, context: Context) -> object:
    """A run in progress continues."""
    context.batches.close(batch_id)
    return _answer(context, batch_id)


def _answer(context: ApiContext, batch_id: str, known: list[str] | None = None) -> BatchAnswer:
    standing = context.batches.standing(batch_id)
    return BatchAnswer.model_validate(
        {
            **standing.batch.document,
            **_known_by(standing.batch),
            "rigs": _rigs(context, standing),
            "units": [_turn(standing, turn) for turn in standing.now.turns if turn.state != "removed"],
            "known": known or [],
        }
    )


def _known_by(batch: Batch) -> dict[str, object]:
    return {"id": batch.id, "created_at": batch.created_at, "closed_at": batch.closed_at}


def _rigs(context: ApiContext, standing: Standing) -> list[BatchRigAnswer]:
    states = {rig.name: rig for rig in context.service.rigs()}
    looks = context.service.looks()
    return [
        _rig(context, standing, name, states.get(name), looks.get(name))
        for name in standing.batch.document["rigs"]
    ]


def _rig(
    context: ApiContext, standing: Standing, name: str, state: object, seen: BoardCheck | None
) -> BatchRigAnswer:
    on, then = standing.now.on[name], standing.now.then[name]
    run = standing.runs.get(on.run_id or "") if on is not None and on.state == "running" else None
    last = _last(standing, name)
    ended = None if last is None else standing.runs[last.run_id or ""]
    progress = None if run is None else run.progress
    return BatchRigAnswer(
        name=name,
        state=getattr(state, "state", "offline"),
        busy_with=getattr(state, "run_id", None),
        on=None if on is None else _turn(standing, on),
        status=None if run is None else run.status,
        progress=progress,
        waiting_for=None if progress is None else progress.waiting_for,
        seen=_seen(standing, seen, on),
        next=None if then is None else _turn(standing, then),
        last=None if last is None else _turn(standing, last),
        last_says=[] if ended is None or ended.verdict is None else ended.verdict.says,
        designing=on is not None and context.batches.is_in_design(standing.batch.id, on.unit),
        nothing_measured=_came_to_nothing(standing, name, on, ended),
    )


def _seen(standing: Standing, seen: BoardCheck | None, on: Turn | None) -> SeenAnswer | None:
    if seen is None or on is None or on.state == "running":
        return None
    return SeenAnswer.model_validate(seen.sighting(standing.mount).of_unit(on.unit))


def _last(standing: Standing, rig: str) -> Turn | None:
    """What ended last on a rig, among what was measured."""
    mine = [turn for turn in standing.now.turns if turn.rig == rig and turn.state in ("done", "failed")]
    ran = (turn for turn in mine if turn.run_id)
    return max(ran, key=lambda turn: str(standing.runs[turn.run_id or ""].finished_at), default=None)


def _came_to_nothing(standing: Standing, rig: str, on: Turn | None, last: Run | None) -> bool:
    """Whether the turn that is to be taken again had its run here, after what was measured last."""
    if on is None or on.state != "waiting" or on.run_id is None:
        return False
    run = standing.runs[on.run_id]
    return run.rig == rig and (last is None or run.created_at > last.created_at)


def _turn(standing: Standing, turn: Turn) -> TurnAnswer:
    run: Run | None = standing.runs.get(turn.run_id or "")
    ended = turn.state in ("done", "failed") and run is not None
    word = word_of(run) if ended and run is not None else None
    why = turn.why or (_failing(run) if turn.state == "failed" and run is not None else None)
    return TurnAnswer.model_validate({**asdict(turn), "word": word, "why": why})


def _failing(run: Run) -> str | None:
    """Why a run fails its limits: by its own verdict, or by what it was there to find out."""
    if run.follows is not None and run.diagnosis is not None and run.diagnosis.get("says"):
        return f"{run.diagnosis['says'][0]}."
    return None if run.verdict is None else " ".join(run.verdict.says[:2])
