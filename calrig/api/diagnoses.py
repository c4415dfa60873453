"""Diagnoses: tracing what calibration left, accepting what was found, the run that separates suspects."""

from typing import Any

from fastapi import APIRouter

from calrig.analysis.error_map import error_map
from calrig.api.context import Context, KnownRun
from calrig.api.diagnosis_models import Accept, Diagnose, DiagnosisAnswer, ErrorMapAnswer
from calrig.api.errors import problems
from calrig.api.models import RunAnswer
from calrig.store import Run

router = APIRouter(tags=["diagnoses"])


@router.post(
    "/api/runs/{run_id}/diagnosis",
    response_model=DiagnosisAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Trace what bias and scale leave of a run",
)
def diagnose(run: KnownRun, body: Diagnose, context: Context) -> dict[str, Any]:
    """With more runs of the unit where `runs` names them. The document is kept with the run."""
    return context.diagnoses.trace(run.id, body.runs)


@router.get(
    "/api/runs/{run_id}/diagnosis",
    response_model=DiagnosisAnswer,
    responses=problems(404),
    summary="The last diagnosis of a run",
)
def last_diagnosis(run: KnownRun, context: Context) -> dict[str, Any]:
    """404 before the first."""
    return context.diagnoses.last(run.id)


@router.post(
    "/api/runs/{run_id}/diagnosis/accept",
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Put effects of a diagnosis in force",
)
def accept(run: KnownRun, body: Accept, context: Context) -> Run:
    """From now on: those of the sensor for the unit, those of the stage for the rig."""
    return context.diagnoses.accept(run.id, body.effects)


@router.post(
    "/api/runs/{run_id}/follow-up",
    status_code=201,
    response_model=RunAnswer,
    responses=problems(404, 409),
    summary="Start the run that separates what the diagnosis could not",
)
def follow_up(run: KnownRun, context: Context) -> Run:
    """409, with the reason, where no run on this rig would help. Its diagnosis is of all runs together."""
    return context.service.follow_up(run.id)


@router.get(
    "/api/rigs/{name}/error-map",
    response_model=ErrorMapAnswer,
    responses=problems(404),
    summary="What every unit on a rig has in common",
)
def show_error_map(name: str, context: Context) -> object:
    """From three units on; empty before. Common firmware, cable or sensor design would look the same."""
    context.service.known_rig(name)
    return error_map(context.store, name)
