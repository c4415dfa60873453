"""Runs: started, listed, controlled and amended; with health, rigs, the port scan and the clamp."""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from pydantic import Field

import calrig
from calrig.analysis.check_standard import with_doubts
from calrig.analysis.run_search import found_runs, moment_of
from calrig.api.access import Who
from calrig.api.context import Context, KnownRun
from calrig.api.jobs import answer_of
from calrig.api.models import Body, Health, Reason, ReasonIfAny, ResumeRun, RunAnswer, RunList, StartRun
from calrig.api.routes import CHANGES, answers
from calrig.instruments import scan as ports
from calrig.instruments.clock import WALL
from calrig.instruments.scan import Found, stanza
from calrig.model.base import Model
from calrig.model.plan import ElevationDeg, MountAxis
from calrig.model.run import Status
from calrig.model.service import RigState, Role
from calrig.run_ids import FEWEST
from calrig.store import Run
from calrig.store.convert import iso_utc
from calrig.store.runs import RunKind, Sought
from calrig.store.verdicts import Judged

router = APIRouter(tags=["runs"])
BACK_TO = "Calrig-Back-To"
Begins = Annotated[str | None, Query(min_length=FEWEST, description="First characters of the run's UUID.")]
Text = Annotated[
    str | None, Query(max_length=200, description="Part of the serial number or the note, in any case.")
]
_DATES = "A time, or a day of UTC (ISO 8601); compared with `created_at`."
Since = Annotated[str | None, Query(alias="from", description=f"The first. {_DATES}")]
Until = Annotated[str | None, Query(alias="to", description=f"A time is excluded, a day included. {_DATES}")]


class ScanAnswer(Model):
    """Every port there is, by name."""

    found: list[Found]
    stanza: str = Field(description="For calrig.toml; empty where no stage was found.")


@router.get("/api/health", summary="Whether the service answers")
async def health() -> Health:
    """The service's version."""
    return Health(status="ok", version=calrig.__version__)


@router.get("/api/rigs", **answers(list[RigState], "Every rig and what it is doing"))
def rigs(context: Context) -> object:
    """In the order configured; the first one is what a run without `rig` takes."""
    return context.service.rigs()


@router.post("/api/rigs/scan", **answers(ScanAnswer, "Look who answers on which port", role="operator"))
async def scan(context: Context) -> object:
    """Moves nothing, but resets most boards; ports of this service's rigs and ports in use are left alone.

    It takes about seven seconds. Concurrent requests share one scan: two scans would find each port in use.
    """
    looking = context.scans.share("scan", WALL, partial(ports.scan, ours=context.service.ports()))
    found = await asyncio.shield(asyncio.wrap_future(looking.future))
    return {"found": found, "stanza": stanza(found, {rig.name for rig in context.service.rigs()})}


@router.post("/api/rigs/{name}/stop", **answers(RigState, "Stop a rig's stage now", 404, 409))
async def stop(name: str, context: Context, who: Who) -> object:
    """A run on the rig is aborted; a stage at rest gets the stop command as well.

    200 once two consecutive reports show the stage at rest at the same angle; else 409 within ten seconds,
    within two where its port does not open.
    """
    return await answer_of(context.service.begin_stop(name, who), f"the stage of rig {name!r}")


@router.delete(
    "/api/rigs/{name}/stop",
    **answers(None, "Withdraw a stop that its bench has not answered", 404, role="operator", status=204),
)
def withdraw_stop(name: str, context: Context, who: Who) -> None:
    """A stop that cannot be delivered stays: the bench obeys it before anything else when it is back.

    404 where none waits, as on a rig of the service's own machine.
    """
    context.store.commands.withdraw_stop(name, who=who)


@router.post("/api/runs", **answers(RunAnswer, "Start a run", *CHANGES, role="operator", status=201))
def start_run(body: StartRun, context: Context, who: Who) -> Run:
    """Everything but `unit` is optional. A busy rig is 409; `queued` lasts until somebody begins the run.

    `operator` is who asks, where that is known by name.
    """
    return context.service.start(**dict(body) | {"operator": who or body.operator})


@router.get("/api/runs", **answers(RunList, "Runs, newest first", 422))
def list_runs(
    context: Context,
    response: Response,
    unit: str | None = None,
    rig: str | None = None,
    status: Status | None = None,
    begins: Begins = None,
    q: Text = None,
    since: Since = None,
    until: Until = None,
    kind: RunKind | None = None,
    verdict: Judged | None = None,
    follows: str | None = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
    cursor: str | None = None,
) -> object:
    """A page of runs; `next_cursor` of the answer is `cursor` of the next question.

    A verdict follows the limits of today: a page of runs with it may hold fewer than `limit`, even none, and
    there are more as long as there is a `next_cursor`. The header `Calrig-Back-To` tells when the
    oldest run was made that was looked at.
    """
    sought = Sought(
        unit=unit,
        rig=rig,
        status=status,
        begins=begins,
        text=q or None,
        since=moment_of(since, "from"),
        before=moment_of(until, "to"),
        kind=kind,
        follows=follows,
    )
    found = found_runs(context.store, sought, verdict, limit, cursor)
    if found.back_to is not None:
        response.headers[BACK_TO] = iso_utc(found.back_to)
    return {"items": found.items, "next_cursor": found.next_cursor}


@router.get("/api/runs/{run_id}", **answers(RunAnswer, "One run", 404))
def show_run(run: KnownRun, context: Context) -> Run:
    """How far it is, what came out and where it came from."""
    return with_doubts(context.store, [run])[0]


@router.post("/api/runs/{run_id}/abort", **answers(RunAnswer, "Stop the stage now and end the run", 404, 409))
async def abort_run(run_id: str, context: Context, who: Who) -> Run:
    """The poses measured so far stay. 200 and 409 as of a stop."""
    errand = context.service.begin_abort(run_id, who)
    if errand is None:  # nobody carries it out: nothing moves, and the store knows the rest
        return await asyncio.to_thread(context.service.abort, run_id, who)  # of no request's threads
    return await answer_of(errand, f"the stage of run {run_id}")


def acts_on_run(
    path: str, role: Role, summary: str, *problem_codes: int
) -> Callable[[Callable[..., Run]], Callable[..., Run]]:
    """Return the decorator of a path that does something to the run it names and answers with the run."""
    codes = problem_codes or CHANGES
    return router.post(f"/api/runs/{{run_id}}/{path}", **answers(RunAnswer, summary, *codes, role=role))


@acts_on_run("pause", "operator", "Finish the pose in hand and hold", 404, 409)
def pause_run(run: KnownRun, context: Context, who: Who) -> Run:
    """The run is `paused` once the pose is done."""
    return context.service.pause(run.id, who)


@acts_on_run("resume", "operator", "Go on with a paused or interrupted run", 404, 409, 422)
def resume_run(run: KnownRun, context: Context, who: Who, body: ResumeRun | None = None) -> Run:
    """Takes a pause that has not begun yet back, too. An interrupted run is `queued` again.

    409 where its rig is busy or not as it was. Where other devices answer than before, the unit was
    touched, or gravity contradicts `stage_at_deg`, it becomes `interrupted` again with the reason in `error`.
    """
    return context.service.resume(run.id, None if body is None else body.stage_at_deg, who)


PoseIndex = Annotated[int, Path(ge=0, lt=2**31)]


class Note(Body):
    """What is to be noted."""

    note: Annotated[str, Field(max_length=10_000)]


class RightUnit(Body):
    """The unit that a run is of, and how that came out."""

    unit: str
    reason: str


@acts_on_run("void", "releaser", "Keep a run, out of every comparison")
def void_run(run: KnownRun, body: Reason, context: Context, who: Who) -> Run:
    """Nothing is deleted."""
    return context.records.void(run.id, body.reason, who=who)


@acts_on_run("unvoid", "releaser", "Have a voided run count again")
def unvoid_run(run: KnownRun, body: Reason, context: Context, who: Who) -> Run:
    """409 where it is not voided. Both reasons are in the trail."""
    return context.records.unvoid(run.id, body.reason, who=who)


@acts_on_run("note", "operator", "Note something of a run", 404, 413, 422)
def note_run(run: KnownRun, body: Note, context: Context, who: Who) -> Run:
    """At any time. It goes below what is noted already, with the time and who says it."""
    return context.records.note(run.id, body.note, who=who)


@acts_on_run("unit", "releaser", "Correct a run's serial number")
def move_run(run: KnownRun, body: RightUnit, context: Context, who: Who) -> Run:
    """The run moves to that unit with what it follows on and what follows on it; both histories say so.

    409 while one goes on, where an effect accepted from one is in force (take it back first), where one is a
    verification, or where a diagnosis is of moving and staying runs together.
    """
    return context.records.move(run.id, body.unit, body.reason, who=who)


@acts_on_run("poses/{index}/exclude", "operator", "Keep a pose, out of the result")
def exclude_pose(run: KnownRun, index: PoseIndex, body: Reason, context: Context, who: Who) -> Run:
    """The result is computed again from the poses that are left."""
    return context.records.exclude_pose(run.id, index, body.reason, who=who)


@acts_on_run("poses/{index}/include", "operator", "Have an excluded pose count again")
def include_pose(
    run: KnownRun, index: PoseIndex, context: Context, who: Who, body: ReasonIfAny | None = None
) -> Run:
    """The result is computed again with it."""
    return context.records.include_pose(run.id, index, None if body is None else body.reason, who=who)


class ClampUnit(Body):
    """How the unit is to be clamped."""

    mount_deg: ElevationDeg
    mount_axis: MountAxis = "x"


@router.post(
    "/api/rigs/{name}/clamp",
    **answers(RigState, "Turn the unit with the rig's clamp", 404, 409, 422, role="operator"),
)
async def clamp(name: str, body: ClampUnit, context: Context) -> object:
    """200 once the unit sits. No run asks for it: it waits for a person, who may use this and then resume.

    409 where the rig has no clamp, or a run is on it that does not wait for the unit to be turned.
    """
    errand = await asyncio.to_thread(context.service.begin_clamp, name, body.mount_deg, body.mount_axis)
    return await asyncio.shield(asyncio.wrap_future(errand.future))
