"""`diagnose` and `gravity`: tracing the residual of a calibration to its physical causes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calrig.cli import options
from calrig.cli.input_files import names_a_file, read_log_file, read_poses_file, told_of
from calrig.cli.options import COLUMNS, SHORTENED, AccelRange, Db, Json, Plot, Rate, Server, whole_id
from calrig.cli.running_service import open_store, running_service, whole_id_there
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from collections.abc import Callable

    from calrig.calibration.poses import Pose
    from calrig.calibration.regression import AssumedReference, DiagnosisRequest
    from calrig.client import Client
    from calrig.figures.files import Rows

    Found = tuple[dict[str, Any], Callable[[], list[list[Pose]]]]
    """A document, and what gives the poses of its runs."""


def diagnose(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE.csv|RUN_ID...",
            autocompletion=options.runs,
            help=f"Poses of one unit, or ids of its runs{SHORTENED}. {COLUMNS}",
        ),
    ],
    as_json: Json = False,
    period: Annotated[
        list[float] | None,
        typer.Option(metavar="DEG", help="A known period of the axis, such as a worm's; may be repeated."),
    ] = None,
    reference: Annotated[
        Literal["good", "stage"] | None,
        typer.Option(
            help="Whose error it is. good: the reference does not err, so curves of the angle are the "
            "sensor's. stage: they may be the stage's. Default: as the rig says, else stage.",
        ),
    ] = None,
    plot: Plot = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Trace the residual after bias and scale to the physical effects behind it.

    Runs are diagnosed by the service that holds their store, where one does: it keeps the diagnosis.
    """
    from calrig.calibration.poses import DiagnosisError
    from calrig.calibration.regression import DiagnosisRequest
    from calrig.cli import output
    from calrig.figures.files import writer_of
    from calrig.model.diagnosis import Diagnosis

    write = None if plot is None else writer_of(plot)
    files = [source for source in sources if names_a_file(source)]
    if files and len(files) < len(sources):
        raise InputError("diagnose: name files or run ids, not both")
    with told_of(", ".join(sources), DiagnosisError):
        request = DiagnosisRequest(reference or "stage", tuple(period or ()))
        found, poses_of = (
            _of_files(files, request)
            if files
            else _of_runs(sources, reference, request.periods_deg, db, server)
        )
    if as_json:
        output.print_json(found)
    elif files:
        output.print_diagnosis(Diagnosis.model_validate(found, extra="allow"), of_files=True)
    else:
        from calrig.client.documents import typed

        output.print_diagnosis(typed(Diagnosis, found), of_files=False)
    if write is not None:
        write(", ".join(sources), _drawn(found, poses_of()))


def gravity(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.csv",
            help=f"A log with many static poses, or a table of one or some rows a position. {COLUMNS}",
        ),
    ],
    rate: Rate = None,
    as_json: Json = False,
    accel_range: AccelRange = None,
) -> None:
    """Calibrate the accelerometer against |a| = 1 g, without a stage, and trace the residual."""
    from calrig.calibration.separation import calibrate_by_gravity, gravity_document
    from calrig.calibration.static_segments import GravityError
    from calrig.cli import output
    from calrig.export.csv_errors import CsvError
    from calrig.export.static_csv import accel_g_of

    log = read_log_file(file, accel_range)
    with told_of(file, CsvError, GravityError):
        found = calibrate_by_gravity(
            accel_g_of(log),
            time_s=log.forward_time_s,
            rate_hz=rate,
            gyro_dps=log.axes("gyro", "dps"),
            temperature_c=log.channels.get("temperature_c"),
        )
    document = gravity_document(found, log.line_of)
    of_time = [f"time_s {log.time_flaw}; not used"] if log.time_flaw else []
    document["warnings"] = [*of_time, *log.warnings, *document["warnings"]]
    output.show(document, output.print_gravity, as_json=as_json)


def _drawn(found: dict[str, Any], runs: Sequence[Sequence[Pose]]) -> Rows:
    from calrig.calibration.diagnosis import drawn_residuals
    from calrig.calibration.poses import DiagnosisError
    from calrig.calibration.regression import DiagnosisRequest
    from calrig.figures.diagnosis import diagnosis_figures

    try:
        request = DiagnosisRequest.of_document(found)
        residuals = drawn_residuals(runs, found["effects"], found["runs"], request)
    except DiagnosisError as error:
        raise WorkError(f"--plot: {error}") from error
    return diagnosis_figures(residuals, found)


def _of_files(files: Sequence[str], request: DiagnosisRequest) -> Found:
    from calrig.calibration.diagnosis import trace
    from calrig.cli.progress import late_bar

    read = [read_poses_file(Path(file)) for file in files]
    with late_bar("diagnosing") as show:
        found = trace([poses for poses, _ in read], files, request=request, progress=show)
    found["warnings"] = [warning for _, warnings in read for warning in warnings] + found["warnings"]
    return found, lambda: [poses for poses, _ in read]


def _of_runs(
    run_ids: Sequence[str],
    reference: AssumedReference | None,
    periods_deg: Sequence[float],
    db: str | None,
    server: str | None,
) -> Found:
    from calrig.cli.progress import late_bar

    there = running_service(server, db)
    if there is not None:
        *more, last = (whole_id_there(there, typed) for typed in run_ids)
        with late_bar("diagnosing") as show:
            there.diagnose(last, *more, reference=reference, periods_deg=periods_deg, told=show)
        found = there.get(f"/api/runs/{last}/diagnosis")
        return found, lambda: [_poses_there(there, run_id) for run_id in found["runs"]]

    from calrig.analysis.diagnoses import Diagnoses
    from calrig.analysis.stored_runs import counted_poses, request_of, runs_together, stored_run
    from calrig.settings import load_settings

    with open_store(db) as store:
        *more, last = (whole_id(store, typed) for typed in run_ids)
        run = stored_run(store, last)
        rigs = [] if run.rig is None else load_settings().rig
        rig = next((rig for rig in rigs if rig.name == run.rig), None)
        request = request_of(run, rig, reference, periods_deg)
        asked = Diagnoses(store).question(last, more, request)
        kept = {run.id: counted_poses(store, run.id) for run in runs_together(store, last, more)}
    with late_bar("diagnosing") as show:
        found = asked(progress=show)
    return found, lambda: [kept[run_id] for run_id in found["runs"]]


def _poses_there(there: Client, run_id: str) -> list[Pose]:
    from calrig.export.poses_csv import read_poses

    return read_poses(there.text(f"/api/runs/{run_id}/poses?format=csv").encode()).poses
