"""The commands that look at measurements: each takes a file from anybody's rig, some a stored run as well."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.calibration.pose import Pose
    from calrig.export.static_csv import StaticLog
    from calrig.noise.filters import FilterStudy

app = typer.Typer(rich_markup_mode=None)

Db = Annotated[str | None, typer.Option(metavar="FILE", help="Store: a path or a URL [CALRIG_DB].")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Log = Annotated[Path, typer.Argument(metavar="FILE.csv", help="A log, one row a sample.")]
AccelRange = Annotated[
    int | None, typer.Option("--accel-range", metavar="G", min=1, help="Full scale of accel counts, g.")
]
GyroRange = Annotated[
    int | None, typer.Option("--gyro-range", metavar="DPS", min=1, help="Full scale of gyro counts, °/s.")
]
LARGEST_LOG = 1_500_000_000
"""Bytes; more than a day at 200 Hz."""
LARGEST_POSES = 50_000_000
READING = 0.4
"""Share of an analysis of noise that goes into reading its file."""


@app.command()
def diagnose(
    sources: Annotated[
        list[str], typer.Argument(metavar="FILE.csv|RUN_ID...", help="Poses of one unit, or ids of its runs.")
    ],
    as_json: Json = False,
    db: Db = None,
) -> None:
    """Trace what bias and scale leave of the poses to the effect the model lacks."""
    from calrig.calibration.diagnosis import trace
    from calrig.calibration.responses import DiagnosisError
    from calrig.cli import terminal

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
    accel_range: AccelRange = None,
) -> None:
    """Calibrate the accelerometer against |g| = 1 where there is no stage, and trace what is left."""
    from calrig.calibration.gravity import calibrate_by_gravity, gravity_document
    from calrig.calibration.static_detector import GravityError
    from calrig.cli import terminal
    from calrig.export.cells import CsvError
    from calrig.export.static_csv import accel_g_of

    log = _log_of(file, accel_range)
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
        _print_json(document)
    else:
        terminal.print_gravity(document)


@app.command()
def noise(
    file: Log,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Samples a second; over time_s.")] = None,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    as_json: Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the figures to FILE.html or FILE.png.")
    ] = None,
) -> None:
    """Say what the noise of a sensor that lies still is: Allan deviation, spectrum, distribution."""
    from calrig.cli import terminal_noise
    from calrig.figures.files import writer_of
    from calrig.noise.analysis import analyse
    from calrig.noise.report import noise_document, said_first

    write = None if plot is None else writer_of(plot)
    with terminal_noise.late_bar(file.name) as show:
        log = _log_of(file, accel_range, gyro_range, lambda share: show(READING * share))
        try:
            found = analyse(
                log.channels, log.time_s, rate, lambda share: show(READING + (1.0 - READING) * share)
            )
        except ValueError as error:
            raise InputError(f"{file}: {error}") from error
    document = said_first(log.warnings, noise_document(found))
    if write is not None:
        from calrig.figures.noise import noise_sheet

        write(noise_sheet(file.name, found))
    if as_json:
        _print_json(document)
    else:
        terminal_noise.print_noise(document)


@app.command()
def filters(
    source: Annotated[
        str, typer.Argument(metavar="FILE.csv|RUN_ID", help="A log with rests and moves, or a run's id.")
    ],
    as_json: Json = False,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Samples a second; over time_s.")] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the figures to FILE.html or FILE.png.")
    ] = None,
    db: Db = None,
) -> None:
    """Put the filters side by side on one log: the paper's, and the one tuned from the unit's noise."""
    from calrig.cli import terminal_noise
    from calrig.figures.files import writer_of
    from calrig.noise.filters import filters_document
    from calrig.noise.report import said_first

    write = None if plot is None else writer_of(plot)
    if _is_file(source):
        found, warnings = _filters_of_file(Path(source), accel_range, gyro_range, rate)
    else:
        found, warnings = _filters_of_run(source, db), ()
    document = said_first(warnings, filters_document(found))
    if write is not None:
        from calrig.figures.filters import filters_sheet

        write(filters_sheet(source, found))
    if as_json:
        _print_json(document)
    else:
        terminal_noise.print_filters(document)


def _filters_of_file(
    file: Path, accel_range: int | None, gyro_range: int | None, rate_hz: float | None
) -> tuple[FilterStudy, tuple[str, ...]]:
    from calrig.noise.filters import study_filters

    log = _log_of(file, accel_range, gyro_range)
    try:
        return study_filters(log.channels, log.time_s, rate_hz), log.warnings
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _filters_of_run(run_id: str, db: str | None) -> FilterStudy:
    from calrig.analysis.noise_studies import filters_of_run
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
        return filters_of_run(store, run_id)


def _log_of(
    file: Path,
    accel_range: int | None,
    gyro_range: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> StaticLog:
    from calrig.export.cells import CsvError
    from calrig.export.static_csv import read_static

    try:
        return read_static(
            read_bytes(file, LARGEST_LOG),
            accel_range_g=accel_range,
            gyro_range_dps=gyro_range,
            progress=progress,
        )
    except CsvError as error:
        raise InputError(f"{file}: {error}") from error


def _is_file(source: str) -> bool:
    """A run's id is a number; anything else is taken for a file, so that a wrong name is said to be one."""
    return not source.isascii() or not source.isdigit() or Path(source).is_file()


def _of_runs(run_ids: Sequence[str], db: str | None) -> dict[str, Any]:
    from calrig.analysis.diagnoses import Diagnoses
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


def read_bytes(file: Path, limit: int = LARGEST_POSES) -> bytes:
    """The file's content, or InputError that says why not; a file that says its size is not read in vain."""
    try:
        with file.open("rb") as opened:
            is_larger = os.fstat(opened.fileno()).st_size > limit
            content = b"" if is_larger else opened.read(limit + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    if is_larger or len(content) > limit:
        raise InputError(f"{file}: has more than {limit} bytes, and no more are read")
    return content


def _print_json(found: dict[str, Any]) -> None:
    typer.echo(json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False))
