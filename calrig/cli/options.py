"""Options and arguments that several commands share, their completion in the shell, and shortened run ids.

Completion asks the service, or reads store and configuration; it gives up silently where nothing answers.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.errors import InputError
from calrig.run_ids import begins_uuid, is_number

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.store import Store


PATIENCE_S = 2.0
MOST_RUNS = 50
"""The newest ones: who wants an older one knows its id."""
Names = Callable[[typer.Context, str], list[str]]
Here = Callable[[typer.Context], Callable[[], list[str]]]
"""What reads the names on this machine; it has been imported by then."""


def _names(there: Callable[[Client], list[str]], here: Here) -> Names:
    """What completes by the service that a command would ask, else by what it would read itself."""

    def asked(ctx: typer.Context) -> Callable[[], list[str]]:
        from calrig.cli.running_service import running_service

        service = running_service(ctx.params.get("server"), ctx.params.get("db"))
        return here(ctx) if service is None else partial(there, service)

    def names(ctx: typer.Context, incomplete: str) -> list[str]:
        seen: list[str] = []

        def look(ask: Callable[[], list[str]]) -> None:
            with suppress(Exception):
                seen.extend(ask())

        with suppress(Exception):  # whatever it is, the command itself will say it
            looking = threading.Thread(target=look, args=(asked(ctx),), daemon=True)
            looking.start()
            looking.join(PATIENCE_S)
        return [name for name in seen if name.startswith(incomplete)]

    return names


def _stored(read: Callable[[Store], list[str]]) -> Here:
    def of_store(ctx: typer.Context) -> Callable[[], list[str]]:
        from calrig.settings import store_url
        from calrig.store import Store

        def names() -> list[str]:
            with Store.open(store_url(ctx.params.get("db")), writer=None) as store:
                return read(store)

        return names

    return of_store


def _configured(ctx: typer.Context) -> Callable[[], list[str]]:
    from calrig.settings import load_settings

    return lambda: [rig.name for rig in load_settings(ctx.params.get("config")).rig]


rigs = _names(lambda service: [rig.name for rig in service.rigs()], _configured)
units = _names(
    lambda service: [unit["serial"] for unit in service.get("/api/units")],
    _stored(lambda store: [unit.serial for unit in store.units.all()]),
)
runs = _names(
    lambda service: [run.id for run in service.runs(limit=MOST_RUNS)],
    _stored(lambda store: [run.id for run in store.runs.page(limit=MOST_RUNS)[0]]),
)


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
LogFormat = Annotated[
    str | None, typer.Option(metavar="text|json", help="Format of the log on standard error [CALRIG_LOG].")
]
Rig = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Rig; without it the first one configured.", autocompletion=rigs),
]
StageAt = Annotated[
    float | None,
    typer.Option(
        min=-360, max=360, metavar="DEG", help="Elevation at which a stage without homing stands now."
    ),
]
UnitSerial = Annotated[
    str,
    typer.Option("--unit", metavar="SERIAL", help="Serial number of the unit.", autocompletion=units),
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


LISTED = 5
"""Of the runs that a beginning may mean."""


def looks_like_an_id(typed: str) -> bool:
    """Whether a person may mean a run by this; where a file is called so, the file is meant."""
    return is_number(typed) or begins_uuid(typed.lower())


def whole_id(store: Store, typed: str) -> str:
    """The id of the run that a person means; what was typed, where there is none.

    Raises:
        InputError: several ids begin so.
    """
    if not begins_uuid(typed.lower()) or store.runs.get(typed) is not None:
        return typed
    return the_one(typed, store.runs.ids_beginning(typed.lower(), LISTED + 1))


def the_one(typed: str, found: Sequence[str]) -> str:
    """The id that begins so; what was typed, where there is none.

    Raises:
        InputError: several ids begin so.
    """
    if len(found) > 1:
        listed = ", ".join(found[:LISTED]) + (" and others" if len(found) > LISTED else "")
        raise InputError(f"run {typed}: several ids begin so ({listed}): type more of the one that is meant")
    return found[0] if found else typed
