"""`noise` and `filters`: what a sensor's noise is, and which filter suits it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

import typer

from calrig.cli import options
from calrig.cli.input_files import names_a_file, read_log_file, told_of
from calrig.cli.options import COLUMNS, SHORTENED, AccelRange, Db, GyroRange, Json, Plot, Rate, whole_id
from calrig.cli.running_service import NAMED, open_store, running_service, whole_id_there

if TYPE_CHECKING:
    from calrig.analysis.log_studies import Found, Study
    from calrig.client import Client
    from calrig.figures.files import Rows
    from calrig.model.noise import FiltersStudy, NoiseStudy

READING = 0.4
"""Share of an analysis of noise that goes into reading its file."""
Keeper = Annotated[
    str | None,
    typer.Option(
        "--server", metavar="URL", help="A running service that analyses the file, and keeps what it finds."
    ),
]


def noise(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help=f"A log, one row a sample. {COLUMNS}")],
    rate: Rate = None,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    as_json: Json = False,
    plot: Plot = None,
    server: Keeper = None,
) -> None:
    """Characterise the noise of a sensor at rest: Allan deviation, spectrum, distribution."""
    from calrig.cli import output
    from calrig.figures.files import writer_of
    from calrig.model.noise import NoiseReport

    write = None if plot is None else writer_of(plot)
    given = _Recorded(rate_hz=rate, accel_range_g=accel_range, gyro_range_dps=gyro_range)
    there = running_service(server, None) if server else None
    document, draw = _of_file("noise", file, given) if there is None else _noise_there(there, file, given)
    if write is not None:
        write(file.name, draw())
    if as_json:
        output.print_json(document)
    else:
        output.print_noise(NoiseReport.model_validate(document))


def filters(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE.csv|RUN_ID",
            autocompletion=options.runs,
            help=f"A log with rest and motion, or a run's id{SHORTENED}. {COLUMNS}",
        ),
    ],
    as_json: Json = False,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    rate: Rate = None,
    plot: Plot = None,
    db: Db = None,
    server: Keeper = None,
) -> None:
    """Compare filters on one log by jitter and lag, with a Kalman filter tuned to the unit's noise."""
    from calrig.cli import output
    from calrig.figures.files import writer_of

    write = None if plot is None else writer_of(plot)
    is_file = names_a_file(source)
    asked = server if is_file else server or os.environ.get(NAMED)
    there = None if is_file and not server else running_service(asked, db)
    given = _Recorded(rate_hz=rate, accel_range_g=accel_range, gyro_range_dps=gyro_range)
    if there is not None:
        document, draw = _filters_there(there, source, given, is_file=is_file)
    else:
        document, draw = _of_file("filters", Path(source), given) if is_file else _filters_of_run(source, db)
    if write is not None:
        write(source, draw())
    output.show(document, output.print_filters, as_json=as_json)


class _Recorded(TypedDict):
    """How a log was recorded, where it does not tell by itself."""

    rate_hz: float | None
    accel_range_g: int | None
    gyro_range_dps: int | None


def _of_file(study: Study, file: Path, given: _Recorded) -> Found:
    from calrig.analysis.log_studies import studied
    from calrig.cli.progress import late_bar

    with late_bar(file.name) as show:
        ranges = given["accel_range_g"], given["gyro_range_dps"]
        log = read_log_file(file, *ranges, lambda share: show(READING * share))
        with told_of(file, ValueError):
            found = log.channels, log.time_s, given["rate_hz"], log.warnings
            return studied(study, *found, progress=lambda share: show(READING + (1.0 - READING) * share))


def _noise_there(client: Client, file: Path, given: _Recorded) -> Found:
    from calrig.cli.progress import late_bars

    with late_bars() as step:
        study = client.noise(file, **given, sent=step(f"sending {file.name}"), told=step(file.name))
    return study.report.model_dump(mode="json"), lambda: _drawn(study)


def _filters_of_run(run_id: str, db: str | None) -> Found:
    from calrig.analysis.noise_studies import filters_of_run
    from calrig.cli.progress import late_bar

    with open_store(db) as store, late_bar("comparing filters"):
        return filters_of_run(store, whole_id(store, run_id))


def _filters_there(client: Client, source: str, given: _Recorded, *, is_file: bool) -> Found:
    from calrig.cli.progress import late_bars

    with late_bars() as step:
        if is_file:
            study = client.filters(source, **given, sent=step(f"sending {source}"), told=step(source))
        else:
            study = client.run(whole_id_there(client, source)).filters(told=step("comparing filters"))
    return study.report, lambda: _drawn(study)


def _drawn(study: NoiseStudy | FiltersStudy) -> Rows:
    return [[(one.caption, dict[str, Any](one.figure))] for one in study.figures]
