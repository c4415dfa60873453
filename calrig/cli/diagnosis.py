"""`diagnose` and `gravity`: tracing the residual of a calibration to its physical causes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from calrig.cli import options
from calrig.cli.input_files import names_a_file, read_log_file, read_poses_file
from calrig.cli.options import COLUMNS, SHORTENED, AccelRange, Db, Json, Server, whole_id
from calrig.cli.running_service import running_service, whole_id_there
from calrig.errors import InputError


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
    db: Db = None,
    server: Server = None,
) -> None:
    """Trace the residual after bias and scale to the physical effects behind it.

    Runs are diagnosed by the service that holds their store, where one does: it keeps the diagnosis.
    """
    from calrig.calibration.poses import DiagnosisError
    from calrig.cli import output
    from calrig.client.documents import typed
    from calrig.model.diagnosis import Diagnosis

    files = [source for source in sources if names_a_file(source)]
    if files and len(files) < len(sources):
        raise InputError("diagnose: name files or run ids, not both")
    try:
        found: object = _of_files(files) if files else _of_runs(sources, db, server)
    except DiagnosisError as error:
        raise InputError(f"{', '.join(sources)}: {error}") from error
    if as_json:
        output.print_json(found)
    else:
        output.print_diagnosis(typed(Diagnosis, found), of_files=bool(files))


def gravity(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.csv", help=f"A log with many static poses. {COLUMNS}")
    ],
    as_json: Json = False,
    accel_range: AccelRange = None,
) -> None:
    """Calibrate the accelerometer against |a| = 1 g, without a stage, and trace the residual."""
    from calrig.calibration.separation import calibrate_by_gravity, gravity_document
    from calrig.calibration.static_detector import GravityError
    from calrig.cli import output
    from calrig.export.csv_errors import CsvError
    from calrig.export.static_csv import accel_g_of

    log = read_log_file(file, accel_range)
    try:
        found = calibrate_by_gravity(
            accel_g_of(log),
            time_s=log.forward_time_s,
            gyro_dps=log.axes("gyro", "dps"),
            temperature_c=log.channels.get("temperature_c"),
        )
    except (CsvError, GravityError) as error:
        raise InputError(f"{file}: {error}") from error
    document = gravity_document(found)
    of_time = [f"time_s {log.time_flaw}; not used"] if log.time_flaw else []
    document["warnings"] = [*of_time, *log.warnings, *document["warnings"]]
    if as_json:
        output.print_json(document)
    else:
        output.print_gravity(document)


def _of_files(files: Sequence[str]) -> dict[str, Any]:
    from calrig.calibration.diagnosis import trace
    from calrig.cli.progress import late_bar

    read = [read_poses_file(Path(file)) for file in files]
    with late_bar("diagnosing") as show:
        found = trace([poses for poses, _ in read], files, progress=show)
    found["warnings"] = [warning for _, warnings in read for warning in warnings] + found["warnings"]
    return found


def _of_runs(run_ids: Sequence[str], db: str | None, server: str | None) -> object:
    from calrig.cli.progress import late_bar

    there = running_service(server, db)
    if there is not None:
        *more, last = (whole_id_there(there, typed) for typed in run_ids)
        with late_bar("diagnosing") as show:
            there.diagnose(last, *more, told=show)
        return there.get(f"/api/runs/{last}/diagnosis")

    from calrig.analysis.diagnoses import Diagnoses
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
        *more, last = (whole_id(store, typed) for typed in run_ids)
        asked = Diagnoses(store).question(last, more)
    with late_bar("diagnosing") as show:
        return asked(progress=show)
