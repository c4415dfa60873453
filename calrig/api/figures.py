"""The page's pictures in plotly's JSON form, drawn by `calrig.figures`."""

from collections.abc import Iterator
from typing import Any, Literal

from fastapi import APIRouter

from calrig import figures
from calrig.api.compare import Units, compared_runs
from calrig.api.context import ApiContext, Context, KnownRun, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import Figure
from calrig.store import Run

BATCH = 5000
"""Events read at once."""

router = APIRouter(tags=["figures"])


@router.get(
    "/api/runs/{run_id}/figures/{name}",
    response_model=Figure,
    responses=problems(404, 422),
    summary="A picture of one run",
)
def run_figure(run: KnownRun, name: Literal["timeline", "residual"], context: Context) -> figures.Figure:
    """`timeline`: stage and reading against time; `residual`: of each pose against elevation."""
    return _timeline(context, run) if name == "timeline" else _residual(context, run)


def _timeline(context: ApiContext, run: Run) -> figures.Figure:
    """From the readings announced during the run; an imported one has none, and its poses stand in."""
    rows = list(_readings(context, run.id)) or [
        stored.pose.row() for stored in context.store.poses(run.id) if stored.pose.time_s is not None
    ]
    time_s, stage_deg, reading_deg = (
        [row[name] for row in rows] for name in ("time_s", "stage_deg", "reading_deg")
    )
    return figures.timeline(time_s, stage_deg, reading_deg)


def _readings(context: ApiContext, run_id: str) -> Iterator[dict[str, Any]]:
    seen = 0
    while events := context.store.events_after(run_id, seen, BATCH):
        yield from (event.data for event in events if event.type == "reading")
        seen = events[-1].seq


def _residual(context: ApiContext, run: Run) -> figures.Figure:
    stored = context.store.poses(run.id)
    result = run.result or {"bias_deg": None, "scale": None}
    return figures.residual(
        [s.pose for s in stored],
        bias_deg=result["bias_deg"],
        scale=result["scale"],
        excluded={place for place, s in enumerate(stored) if s.excluded is not None},
    )


@router.get(
    "/api/units/{serial:path}/figures/history",
    response_model=Figure,
    responses=problems(404),
    summary="A unit's history",
)
def unit_history(unit: KnownUnit, context: Context) -> figures.Figure:
    """Bias, scale and RMS of its runs over time."""
    return figures.history(compared_runs(context, [unit.serial])[unit.serial])


@router.get(
    "/api/compare/figures/{name}",
    response_model=Figure,
    responses=problems(404, 422),
    summary="A picture of several units",
)
def compare_figure(
    name: Literal["bias", "scale", "rms", "residuals"], context: Context, unit: Units = None
) -> figures.Figure:
    """`bias`, `scale`, `rms` over time; `residuals`: of each unit's latest run, laid over each other."""
    units = compared_runs(context, unit)
    if name != "residuals":
        return figures.compare(name, units)
    curves = [_curve(context, serial, runs[-1]) for serial, runs in units.items() if runs]
    return figures.residuals_overlaid(curves)


def _curve(context: ApiContext, serial: str, run: figures.Run) -> figures.Curve:
    counted = [s.pose for s in context.store.poses(run["run_id"], include_excluded=False)]
    return figures.Curve(serial, counted, run["bias_deg"], run["scale"])
