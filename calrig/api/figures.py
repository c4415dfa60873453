"""The page's pictures in plotly's JSON form, drawn by `calrig.figures`."""

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Path, Query

from calrig import figures
from calrig.analysis.calibration_in_force import Fit, residuals_of
from calrig.analysis.check_standard import check_chart
from calrig.analysis.comparison import ComparedFigure, compared_figure, compared_runs
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import charts, histories
from calrig.api.context import ApiContext, Context, KnownRun, KnownUnit
from calrig.api.jobs import Heavy
from calrig.api.routes import answers
from calrig.api.units import Units, of_units
from calrig.model.noise import Figure
from calrig.store import Run
from calrig.store.records import Document

BATCH = 5000
"""Events read at once."""
EFFECT = "effect-"
RunFigure = Annotated[str, Path(pattern=rf"^(timeline|residual|diagnosis|{EFFECT}\d{{1,3}})$")]

Chosen = Annotated[list[str] | None, Query(description="Units with a colour where not all have one.")]

router = APIRouter(tags=["figures"])


@router.get("/api/runs/{run_id}/figures/{name}", **answers(Figure, "A picture of one run", 404, 409, 422))
def run_figure(run: KnownRun, name: RunFigure, context: Context, fit: Fit = "verdict") -> figures.Figure:
    """What was measured, or what its last diagnosis (404 before) has found.

    `timeline`: stage and reading against time; `residual`: of each pose against elevation, as
    the verdict judges it or (`fit=plain`) by bias and scale alone; `diagnosis`: the
    error before and after; `effect-0`, …: the partial residual of its first effect, against the covariate.
    """
    if name == "timeline":
        return _timeline(context, run)
    if name == "residual":
        return _residual(context, run, fit)
    if name == "diagnosis":
        return figures.before_and_after(context.diagnoses.last(run.id))
    return _effect(context, run, int(name.removeprefix(EFFECT)))


def _effect(context: ApiContext, run: Run, place: int) -> figures.Figure:
    partial = context.diagnoses.partial_residuals(run.id)
    if place >= len(partial):
        raise Unknown(f"the diagnosis of run {run.id} has {len(partial)} effects, counted from 0")
    return figures.partial_residual(partial[place])


def _timeline(context: ApiContext, run: Run) -> figures.Figure:
    """From the readings announced during the run; an imported one has none, and its poses stand in."""
    rows = [(row["time_s"], row["stage_deg"], row["reading_deg"]) for row in _readings(context, run.id)] or [
        (stored.pose.time_s, stored.pose.stage_deg, stored.pose.reading_deg)
        for batch in context.store.poses.batches_of(run.id)
        for stored in batch
        if stored.pose.time_s is not None
    ]
    time_s, stage_deg, reading_deg = ([row[place] for row in rows] for place in range(3))
    return figures.timeline(time_s, stage_deg, reading_deg, _time_scale(context, run))


def _time_scale(context: ApiContext, run: Run) -> float:
    """Return the seconds of a run's clocks for one on the wall, as stored with it, else as configured."""
    if run.rig is None or run.plan is None:
        return 1.0
    stated = (run.provenance.get("rig") or {}).get("time_scale")
    if stated is None:
        with suppress(Unknown):
            stated = context.service.known_rig(run.rig).time_scale
    return float(stated or 1.0)


def _readings(context: ApiContext, run_id: str) -> Iterator[Document]:
    seen = 0
    while events := context.store.events.after(run_id, seen, BATCH):
        yield from (event.data for event in events if event.type == "reading")
        seen = events[-1].seq


def _judged(run: Run, fit: Fit) -> str:
    """Return what the lower half of the residuals shows, in words."""
    if fit == "plain":
        return "bias and scale alone"
    if run.kind == "verification":
        return "error of indication"
    has_effects = run.result is not None and run.result.rms_with_effects_deg is not None
    return "with effects" if has_effects else "calibrated"


def _residual(context: ApiContext, run: Run, fit: Fit) -> figures.Figure:
    stored = context.store.poses.of(run.id)
    poses = [s.pose for s in stored]
    return figures.residual(
        poses,
        left_deg=None if run.result is None else residuals_of(context.store, run, poses, fit),
        what=_judged(run, fit),
        scale=None if run.result is None else run.result.scale,
        excluded={place for place, s in enumerate(stored) if s.excluded is not None},
    )


@router.get("/api/units/{serial:path}/figures/history", **answers(Figure, "A unit's history", 404))
def unit_history(unit: KnownUnit, context: Context) -> figures.Figure:
    """Bias, scale and RMS of its runs over time."""
    found = histories(context.store, [unit.serial])
    return figures.history(compared_runs(context.store, [unit.serial], found)[unit.serial])


@router.get("/api/units/{serial:path}/figures/chart", **answers(Figure, "A unit's control chart", 404))
def unit_chart(unit: KnownUnit, context: Context) -> figures.Figure:
    """Moving averages of bias and scale since the unit last changed; empty where repeatability is unknown."""
    found = histories(context.store, [unit.serial])
    drawn = {
        name: chart
        for name, chart in zip(("bias", "scale"), charts(found, unit.serial), strict=True)
        if chart
    }
    averages = {name: chart.average.tolist() for name, chart in drawn.items()}
    limit: list[float] = next((chart.limit.tolist() for chart in drawn.values()), [])
    when = [found.rows[place].finished_at for place in found.of(unit.serial)] if drawn else []
    return figures.control_chart(when, averages, limit)


@router.get("/api/rigs/{name}/figures/check-unit", **answers(Figure, "A rig's control chart", 404))
def rig_chart(name: str, context: Context) -> figures.Figure:
    """Moving averages of its check unit's bias and scale."""
    context.service.known_rig(name)
    return figures.control_chart(*check_chart(context.store, name))


@router.get(
    "/api/compare/figures/{name}", **answers(Figure, "A picture of several units", 404, 422, 429, 503)
)
def compare_figure(
    name: ComparedFigure,
    context: Context,
    heavy: Heavy,
    unit: Units = None,
    chosen: Chosen = None,
) -> figures.Figure:
    """`bias`, `scale`, `rms` over time; `residuals`: of each unit's latest run, laid over each other.

    Where units are more than colours, all but the `chosen` ones are dimmed; without any, all but those that
    changed (or the first eight, where none did).
    """
    return of_units(context, heavy, unit, partial(compared_figure, name, unit, chosen))
