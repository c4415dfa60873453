"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calrig.cli import names

COLUMNS = "Columns: calrig/docs/reference/file-formats.md."
SHORTENED = " (the first 6 characters of a UUID do)"
Db = Annotated[str | None, typer.Option(metavar="FILE", help="Store: a path or a URL [CALRIG_DB].")]
Server = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        envvar="CALRIG_SERVER",
        show_envvar=False,
        help="The running service that holds the store [CALRIG_SERVER], asked with CALRIG_TOKEN.",
    ),
]
Config = Annotated[str | None, typer.Option(metavar="FILE", help="Configuration [CALRIG_CONFIG].")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Record = Annotated[
    Path | None,
    typer.Option("--record", metavar="DIR", help="Record every byte on the wires in this folder."),
]
Rig = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Rig; without it the first one configured.", autocompletion=names.rigs),
]
StageAt = Annotated[
    float | None,
    typer.Option(
        min=-360, max=360, metavar="DEG", help="Elevation at which a stage without homing stands now."
    ),
]
UnitSerial = Annotated[
    str,
    typer.Option("--unit", metavar="SERIAL", help="Serial number of the unit.", autocompletion=names.units),
]
Rate = Annotated[float | None, typer.Option(metavar="HZ", help="Sampling rate; overrides time_s.")]
AccelRange = Annotated[
    int | None,
    typer.Option("--accel-range", metavar="G", min=1, help="Full scale of accelerometer counts, g."),
]
GyroRange = Annotated[
    int | None, typer.Option("--gyro-range", metavar="DPS", min=1, help="Full scale of gyro counts, °/s.")
]
Plot = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write the figures to FILE.html or FILE.png.")
]
