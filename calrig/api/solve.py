"""Joint solutions of stored runs (CONTRACT section 8): stage, mounts and units; each solution is stored."""

from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Depends, Query
from fastapi.responses import Response
from pydantic import Field, model_validator
from starlette.concurrency import run_in_threadpool

from calrig import figures
from calrig.analysis.errors import Invalid, Unknown
from calrig.analysis.solutions import SolutionRequest, answer, question
from calrig.api.access import Who
from calrig.api.context import ApiContext, Context
from calrig.api.job import Job
from calrig.api.jobs import Heavy, Wait
from calrig.api.models import Body
from calrig.api.routes import CHANGES, answers
from calrig.calibration.poses import DiagnosisError
from calrig.export.solution_documents import in_file
from calrig.figures.joint import joint_figure
from calrig.model.noise import Figure
from calrig.model.solution import Frame, ListedSolution, PoseResiduals, Solution
from calrig.store.records import Document
from calrig.store.solutions import StoredSolution

MOST_NAMED = 2000


class Solve(Body):
    """What to solve together; runs, units or a rig."""

    runs: list[str] = Field(default=[], max_length=MOST_NAMED)
    units: list[str] = Field(
        default=[], max_length=MOST_NAMED, description="All calibrations that count of these units."
    )
    rig: str | None = Field(default=None, description="The rig of the runs; alone, of all of its runs.")
    linear: bool = Field(
        default=False, description="Whether the units are stated to have no quadratic and cubic terms."
    )
    periods_deg: list[Annotated[float, Field(ge=0.5, le=360)]] = Field(
        default=[], max_length=24, description="Known periods of gears, degrees of the dial."
    )
    seat_std_deg: float | None = Field(
        default=None, ge=0, le=90, description="How far one clamping of a face scatters from the next."
    )
    frame: Frame = Field(
        default="sensor",
        description="Of units clamped by several faces, whose their accelerometer's matrix is.",
    )
    limits_deg: tuple[float, float] | None = Field(
        default=None, description="What is advised keeps to them; without, to those of the last run."
    )

    @model_validator(mode="after")
    def _names_something(self) -> Self:
        if not (self.runs or self.units or self.rig):
            raise ValueError("name runs, units or a rig: there is nothing to solve")
        return self

    @model_validator(mode="after")
    def _limits_rise(self) -> Self:
        if self.limits_deg is not None and self.limits_deg[0] >= self.limits_deg[1]:
            raise ValueError("limits_deg is the lower, then the upper")
        return self


router = APIRouter(tags=["solve"])
MOST_LISTED = 500


def _known_solution(solution_id: str, context: Context) -> StoredSolution:
    return context.store.solutions.get(solution_id)


KnownSolution = Annotated[StoredSolution, Depends(_known_solution)]


@router.post(
    "/api/solve",
    **answers(
        Solution, "Solve stage, mounts and units of runs together", *CHANGES, role="operator", as_job=True
    ),
)
async def solve(body: Solve, context: Context, heavy: Heavy, who: Who, wait: Wait = True) -> Any:
    """Of the runs named and all calibrations that count of the units named; of a rig alone, of all on it.

    They are of one rig. The solution is kept; it changes nothing that is in force.
    """
    wanted = SolutionRequest(**body.model_dump())
    await run_in_threadpool(_require_rig, context, wanted.rig)

    async def work(job: Job) -> Solution:
        asked = await run_in_threadpool(question, context.store, wanted)
        try:
            found = await job.run(partial(answer, asked), tells_progress=True)
        except DiagnosisError as error:
            raise Invalid(str(error), ["runs"]) from error
        return _shown(await run_in_threadpool(context.store.solutions.save, found, by=who))

    return await heavy.answer(work, wait=wait, kept_at=lambda kept: f"/api/solve/{kept.id}")


@router.get("/api/solve", **answers(list[ListedSolution], "Solutions, newest first"))
def list_solutions(
    context: Context,
    rig: str | None = None,
    limit: Annotated[int, Query(ge=1, le=MOST_LISTED)] = 100,
) -> list[ListedSolution]:
    """What each rests on, and the RMS of held-out poses without and with the map."""
    return context.store.solutions.newest(rig, limit)


@router.get("/api/solve/{solution_id}", **answers(Solution, "A solution", 404))
def show_solution(solution: KnownSolution) -> Solution:
    """As it was found: what has become of its runs since is not in it."""
    return _shown(solution)


@router.get(
    "/api/solve/{solution_id}/map",
    **answers(None, "The stage's map of a solution", 404, sends={"application/json": {}}),
)
def solution_map(solution: KnownSolution) -> Response:
    """The file `stage-map.json`, which a rig takes as its reference."""
    return _file(solution.found.stage_map)


@router.get(
    "/api/solve/{solution_id}/units/{serial:path}",
    **answers(None, "A unit's calibration by a solution", 404, sends={"application/json": {}}),
)
def solution_calibration(solution: KnownSolution, serial: str) -> Response:
    """CONTRACT section 6, with the uncertainty of this solution; it is no revision and never in force."""
    if serial not in solution.found.calibrations:
        raise Unknown(f"solution {solution.id} has no unit {serial!r}")
    return _file(solution.found.calibrations[serial])


@router.get(
    "/api/solve/{solution_id}/poses",
    **answers(PoseResiduals, "What each pose of a solution leaves of its angle", 404),
)
def solution_poses(solution: KnownSolution) -> Document:
    """Columns of the poses that were not left out as wild."""
    return solution.found.poses


@router.get("/api/solve/{solution_id}/figures/{name}", **answers(Figure, "A picture of a solution", 404, 422))
def solution_figure(solution: KnownSolution, name: Literal["map", "before", "after"]) -> figures.Figure:
    """`map`: the stage's, with its poses; `before`, `after`: what poses leave without it and with it."""
    return joint_figure(name, solution.found.document, solution.found.poses)


def _require_rig(context: ApiContext, rig: str | None) -> None:
    """Raises Unknown where neither this service nor any run knows a rig of the name."""
    if rig is not None and not context.store.runs.page(rig=rig, limit=1)[0]:
        context.service.known_rig(rig)


def _shown(kept: StoredSolution) -> Solution:
    known_by = {"id": kept.id, "created_at": kept.created_at, "by": kept.by, "rig": kept.found.rig}
    return Solution.model_validate({**asdict(kept.found.basis), **known_by, **kept.found.document})


def _file(document: Document) -> Response:
    return Response(in_file(document), media_type="application/json")
