"""Units side by side."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic_core import to_json

from calrig.analysis.errors import Unknown
from calrig.api.context import ApiContext, Context
from calrig.api.errors import problems
from calrig.api.models import Comparison
from calrig.calibration.compare import components, drift
from calrig.store import ComparisonRow

Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]
Row = dict[str, Any]

router = APIRouter(tags=["units"])


@router.get("/api/compare", response_model=Comparison, responses=problems(404), summary="Units side by side")
def compare(context: Context, unit: Units = None) -> Response:
    """Completed, not voided calibrations only; `spread` sets units apart from repeatability."""
    units = compared_runs(context, unit)
    document = {
        "units": [_unit(serial, runs) for serial, runs in units.items()],
        "spread": {figure: _spread(list(units.values()), figure) for figure in ("bias_deg", "scale")},
    }
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(to_json(document, inf_nan_mode="null"), media_type="application/json")


def compared_runs(context: ApiContext, serials: Sequence[str] | None) -> dict[str, list[Row]]:
    """Each unit's rows of the comparison, the oldest first.

    Raises:
        Unknown: there is no such unit.
    """
    known = dict.fromkeys(unit.serial for unit in context.store.units())
    for serial in serials or ():
        if serial not in known:
            raise Unknown(f"there is no unit {serial!r}")
    units: dict[str, list[Row]] = {serial: [] for serial in serials or known}
    effects = context.store.effect_names()
    for row in context.store.comparison(serials or None):
        units[row.unit].append(_row(row, effects))
    return units


def _row(row: ComparisonRow, effects: Mapping[str, list[str]]) -> Row:
    return {
        "run_id": row.run_id,
        "finished_at": row.finished_at,
        "bias_deg": row.bias_deg,
        "bias_std_deg": row.bias_std_deg,
        "scale": row.scale,
        "scale_std": row.scale_std,
        "rms_raw_deg": row.rms_raw_deg,
        "rms_calibrated_deg": row.rms_calibrated_deg,
        "rms_with_effects_deg": row.rms_with_effects_deg,
        "temperature_c": {"min": row.temperature_min_c, "max": row.temperature_max_c},
        "effects": [] if row.rms_with_effects_deg is None else effects.get(row.unit, []),
    }


def _unit(serial: str, runs: Sequence[Row]) -> Row:
    drifts = drift([run["finished_at"] for run in runs], [run["bias_deg"] for run in runs])
    return {"unit": serial, "runs": runs, "drift_deg_per_day": drifts.deg_per_day if drifts else None}


def _spread(units: Sequence[Sequence[Row]], figure: str) -> Row:
    known = [(k, run[figure]) for k, runs in enumerate(units) for run in runs if run[figure] is not None]
    found = components([k for k, _ in known], [value for _, value in known])
    return {"between_units_std": found.between, "within_unit_std": found.within}
