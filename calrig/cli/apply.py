"""`apply`: a calibration on readings."""

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from calrig.cli.options import COLUMNS
from calrig.errors import InputError, printable

STDIN = "standard input"


def apply(
    calibration: Annotated[
        str,
        typer.Argument(
            metavar="CALIBRATION.json",
            help="A file, or an address such as http://lab-pc:8000/api/units/AS-0042/calibration "
            "(with the token of CALRIG_TOKEN).",
        ),
    ],
    readings: Annotated[
        Path | None,
        typer.Argument(
            metavar="READINGS.csv",
            help=f"reading_deg, or accel_y_g and accel_z_g; without it standard input. {COLUMNS}",
        ),
    ] = None,
) -> None:
    """Print the readings with calibrated elevations and standard uncertainties, as CSV."""
    from calrig.calibration.regression import ApplyError
    from calrig.calibration.results import Application
    from calrig.export.applied_csv import Applier
    from calrig.export.calibration_document import read_document
    from calrig.export.csv_errors import CsvError

    document = read_document(calibration)
    name = STDIN if readings is None else str(readings)
    try:
        applier = Applier(Application.of_document(document))
        with nullcontext(sys.stdin.buffer) if readings is None else readings.open("rb") as stream:
            for rows in applier.rows(stream):
                sys.stdout.write(rows)
    except CsvError as error:
        raise InputError(f"{name}: {error}") from error
    except ApplyError as error:
        raise InputError(f"{calibration}: cannot be applied ({error})") from error
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError(f"{name}: cannot be read ({error.strerror})") from error
    for sentence in applier.warnings():
        typer.echo(f"calrig apply: {printable(f'{name}: {sentence}')}", err=True)
