"""Stage, mounts and units solved together, of stored runs; solutions are kept."""

# No `from __future__ import annotations`: FastAPI reads the annotations of the paths.

from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

from calrig import figures
from calrig.analysis.errors import Invalid, Unknown
from calrig.analysis.joint_solutions import Wanted, answer, question
from calrig.api.callers import Who, requires
from calrig.api.context import ApiContext, Context
from calrig.api.errors import problems
from calrig.api.heavy import ACCEPTED, Heavy, Wait
from calrig.api.job import Job
from calrig.api.models import Figure
from calrig.api.solve_models import ListedSolution, PosesLeft, SolutionAnswer, Solve
from calrig.calibration.poses import DiagnosisError
from calrig.export.joint_files import in_file
from calrig.figures.joint import joint_figure
from calrig.store.solutions import ListedSolution as Listed
from calrig.store.solutions import StoredSolution

router = APIRouter(tags=["solve"])
MOST_LISTED = 500


def _known_solution(solution_id: str, context: Context) -> StoredSolution:
    return context.store.solution(solution_id)


KnownSolution = Annotated[StoredSolution, Depends(_known_solution)]


@router.post(
    "/api/solve",
    dependencies=[requires("operator")],
    response_model=SolutionAnswer,
    responses=ACCEPTED | problems(404, 409, 413, 422),
    summary="Solve stage, mounts and units of runs together",
)
async def solve(body: Solve, context: Context, heavy: Heavy, who: Who, wait: Wait = True) -> Any:
    """Of the runs named and all calibrations that count of the units named; of a rig alone, of all on it.

    They are of one rig. The solution is kept; it changes nothing that is in force.
    """
    wanted = Wanted(**body.model_dump())
    await run_in_threadpool(_require_rig, context, wanted.rig)

    async def work(job: Job) -> dict[str, Any]:
        asked = await run_in_threadpool(question, context.store, wanted)
        try:
            found = await job.run(partial(answer, asked), tells_progress=True)
        except DiagnosisError as error:
            raise Invalid(str(error), ["runs"]) from error
        return _shown(await run_in_threadpool(context.store.keep_solution, found, by=who))

    return await heavy.answer(work, wait=wait, kept_at=lambda kept: f"/api/solve/{kept['id']}")


@router.get("/api/solve", response_model=list[ListedSolution], summary="Solutions, newest first")
def list_solutions(
    context: Context,
    rig: str | None = None,
    limit: Annotated[int, Query(ge=1, le=MOST_LISTED)] = 100,
) -> list[dict[str, Any]]:
    """What each rests on, and the RMS of held-out poses without and with the map."""
    return [_listed(one) for one in context.store.solutions(rig, limit)]


@router.get(
    "/api/solve/{solution_id}",
    response_model=SolutionAnswer,
    responses=problems(404),
    summary="A solution",
)
def show_solution(solution: KnownSolution) -> dict[str, Any]:
    """As it was found: what has become of its runs since is not in it."""
    return _shown(solution)


@router.get(
    "/api/solve/{solution_id}/map",
    response_class=Response,
    responses={200: {"content": {"application/json": {}}}, **problems(404)},
    summary="The stage's map of a solution",
)
def solution_map(solution: KnownSolution) -> Response:
    """The file `stage-map.json`, which a rig takes as its reference."""
    return _file(solution.found.stage_map)


@router.get(
    "/api/solve/{solution_id}/units/{serial:path}",
    response_class=Response,
    responses={200: {"content": {"application/json": {}}}, **problems(404)},
    summary="A unit's calibration by a solution",
)
def solution_calibration(solution: KnownSolution, serial: str) -> Response:
    """CONTRACT section 6, with the uncertainty of this solution; it is no revision and never in force."""
    if serial not in solution.found.calibrations:
        raise Unknown(f"solution {solution.id} has no unit {serial!r}")
    return _file(solution.found.calibrations[serial])


@router.get(
    "/api/solve/{solution_id}/poses",
    response_model=PosesLeft,
    responses=problems(404),
    summary="What each pose of a solution leaves of its angle",
)
def solution_poses(solution: KnownSolution) -> dict[str, Any]:
    """Columns of the poses that were not left out as wild."""
    return solution.found.poses


@router.get(
    "/api/solve/{solution_id}/figures/{name}",
    response_model=Figure,
    responses=problems(404, 422),
    summary="A picture of a solution",
)
def solution_figure(solution: KnownSolution, name: Literal["map", "before", "after"]) -> figures.Figure:
    """`map`: the stage's, with its poses; `before`, `after`: what poses leave without it and with it."""
    return joint_figure(name, solution.found.document, solution.found.poses)


def _require_rig(context: ApiContext, rig: str | None) -> None:
    """Raises Unknown where neither this service nor any run knows a rig of the name."""
    if rig is not None and not context.store.runs(rig=rig, limit=1)[0]:
        context.service.known_rig(rig)


def _shown(kept: StoredSolution) -> dict[str, Any]:
    return {**_beside(kept, kept.found), **kept.found.document}


def _listed(one: Listed) -> dict[str, Any]:
    return {
        **_beside(one, one),
        "units": list(one.basis.units),
        "separable": one.separable,
        "before": {"held_out_rms_deg": one.before_rms_deg},
        "final": {"held_out_rms_deg": one.final_rms_deg},
    }


def _beside(kept: StoredSolution | Listed, found: Any) -> dict[str, Any]:
    """What an answer has beside the document, of which `units` is a part."""
    return {
        "id": kept.id,
        "created_at": kept.created_at,
        "by": kept.by,
        "rig": found.rig,
        "runs": list(found.basis.runs),
        "linear": found.basis.linear,
        "periods_deg": list(found.basis.periods_deg),
        "seat_std_deg": found.basis.seat_std_deg,
        "frame": found.basis.frame,
    }


def _file(document: dict[str, Any]) -> Response:
    return Response(in_file(document), media_type="application/json")
