"""`noise` and `filters`: what a sensor's noise is, and which filter suits it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.input_files import names_a_file, read_log_file
from calrig.cli.options import COLUMNS, SHORTENED, AccelRange, Db, GyroRange, Json, Plot, Rate
from calrig.cli.typed_ids import whole_id
from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.noise.filters import FilterStudy

READING = 0.4
"""Share of an analysis of noise that goes into reading its file."""


def noise(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help=f"A log, one row a sample. {COLUMNS}")],
    rate: Rate = None,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    as_json: Json = False,
    plot: Plot = None,
) -> None:
    """Characterise the noise of a sensor at rest: Allan deviation, spectrum, distribution."""
    from calrig.cli import output
    from calrig.cli.progress import late_bar
    from calrig.figures.files import writer_of
    from calrig.noise.analysis import analyse
    from calrig.noise.report import noise_document, said_first

    write = None if plot is None else writer_of(plot)
    with late_bar(file.name) as show:
        log = read_log_file(file, accel_range, gyro_range, lambda share: show(READING * share))
        try:
            found = analyse(
                log.channels, log.time_s, rate, lambda share: show(READING + (1.0 - READING) * share)
            )
        except ValueError as error:
            raise InputError(f"{file}: {error}") from error
    document = said_first(log.warnings, noise_document(found))
    if write is not None:
        from calrig.figures.noise import noise_figures

        write(file.name, noise_figures(found))
    if as_json:
        output.print_json(document)
    else:
        output.print_noise(document)


def filters(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE.csv|RUN_ID", help=f"A log with rest and motion, or a run's id{SHORTENED}. {COLUMNS}"
        ),
    ],
    as_json: Json = False,
    accel_range: AccelRange = None,
    gyro_range: GyroRange = None,
    rate: Rate = None,
    plot: Plot = None,
    db: Db = None,
) -> None:
    """Compare filters on one log by jitter and lag, with a Kalman filter tuned to the unit's noise."""
    from calrig.cli import output
    from calrig.figures.files import writer_of
    from calrig.noise.filters import filters_document
    from calrig.noise.report import said_first

    write = None if plot is None else writer_of(plot)
    if names_a_file(source):
        found, warnings = _filters_of_file(Path(source), accel_range, gyro_range, rate)
    else:
        found, warnings = _filters_of_run(source, db), ()
    document = said_first(warnings, filters_document(found))
    if write is not None:
        from calrig.figures.filters import filters_figures

        write(source, filters_figures(found))
    if as_json:
        output.print_json(document)
    else:
        output.print_filters(document)


def _filters_of_file(
    file: Path, accel_range_g: int | None, gyro_range_dps: int | None, rate_hz: float | None
) -> tuple[FilterStudy, tuple[str, ...]]:
    from calrig.noise.filters import study_filters

    log = read_log_file(file, accel_range_g, gyro_range_dps)
    try:
        return study_filters(log.channels, log.time_s, rate_hz), log.warnings
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _filters_of_run(run_id: str, db: str | None) -> FilterStudy:
    from calrig.analysis.noise_studies import filters_of_run
    from calrig.settings import store_url
    from calrig.store import Store

    with Store.open(store_url(db), writer=None) as store:
        return filters_of_run(store, whole_id(store, run_id))
