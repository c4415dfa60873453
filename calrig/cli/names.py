"""Names that a shell completes: rigs, units and runs, as the service knows them, or store and configuration.

Quick, and silent where nobody answers: somebody is typing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import typer

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
    _stored(lambda store: [unit.serial for unit in store.units()]),
)
runs = _names(
    lambda service: [run.id for run in service.runs(limit=MOST_RUNS)],
    _stored(lambda store: [run.id for run in store.runs(limit=MOST_RUNS)[0]]),
)
