"""The commands that look at measurements: each takes a file from anybody's rig, some a stored run as well."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli_errors import InputError

if TYPE_CHECKING:
    from calrig.calibration.pose import Pose

app = typer.Typer(rich_markup_mode=None)

Db = Annotated[str | None, typer.Option(metavar="FILE", help="Store: a path or a URL [CALRIG_DB].")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


@app.command()
def diagnose(
    sources: Annotated[
        list[str], typer.Argument(metavar="FILE.csv|RUN_ID...", help="Poses of one unit, or ids of its runs.")
    ],
    as_json: Json = False,
    db: Db = None,
) -> None:
    """Trace what bias and scale leave of the poses to the effect the model lacks."""
    from calrig import terminal
    from calrig.calibration.diagnosis import trace
    from calrig.calibration.responses import DiagnosisError

    files = [source for source in sources if _is_file(source)]
    if files and len(files) < len(sources):
        raise InputError("diagnose: name files or run ids, not both")
    try:
        if files:
            read = [_poses_of(Path(file)) for file in files]
            found = trace([poses for poses, _ in read], files)
            found["warnings"] = [warning for _, said in read for warning in said] + found["warnings"]
        else:
            found = _of_runs(sources, db)
    except DiagnosisError as error:
        raise InputError(f"{', '.join(sources)}: {error}") from error
    if as_json:
        _print_json(found)
    else:
        terminal.print_diagnosis(found)


@app.command()
def gravity(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help="A log with many still poses.")],
    as_json: Json = False,
    accel_range_g: Annotated[int | None, typer.Option(metavar="G", help="Full scale of raw counts.")] = None,
) -> None:
    """Calibrate the accelerometer against |g| = 1 where there is no stage, and trace what is left."""
    from calrig import terminal
    from calrig.calibration.gravity import calibrate_by_gravity, gravity_document
    from calrig.calibration.still import GravityError
    from calrig.export.cells import CsvError
    from calrig.export.static_csv import accel_g_of, read_static

    try:
        log = read_static(read_bytes(file), accel_range_g=accel_range_g)
        found = calibrate_by_gravity(
            accel_g_of(log),
            time_s=log.time_s,
            gyro_dps=log.axes("gyro", "dps"),
            temperature_c=log.channels.get("temperature_c"),
        )
    except (CsvError, GravityError) as error:
        raise InputError(f"{file}: {error}") from error
    document = gravity_document(found)
    document["warnings"] = [*log.warnings, *document["warnings"]]
    if as_json:
        _print_json(document)
    else:
        terminal.print_gravity(document)


def _is_file(source: str) -> bool:
    """A run's id is a number; anything else is taken for a file, so that a wrong name is said to be one."""
    return not source.isascii() or not source.isdigit() or Path(source).is_file()


def _of_runs(run_ids: Sequence[str], db: str | None) -> dict[str, Any]:
    from calrig.runs.diagnosing import Diagnoses
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
        return Diagnoses(store).traced(run_ids[-1], run_ids[:-1])


def _poses_of(file: Path) -> tuple[list[Pose], list[str]]:
    from calrig.export.poses_csv import CsvError, read_poses

    try:
        imported = read_poses(read_bytes(file))
    except CsvError as error:
        raise InputError(f"{file}: {error}") from error
    return imported.poses, imported.warnings


def read_bytes(file: Path) -> bytes:
    """The file's content, or InputError that says why not."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error


def _print_json(found: dict[str, Any]) -> None:
    typer.echo(json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False))
