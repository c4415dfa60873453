"""`bench`: which benches a centre has, in its database or at the running service."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import quote

import typer

from calrig.cli.help_listing import Listed
from calrig.cli.options import Db, Json, Server
from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.store import Store
    from calrig.store.enrolment import Membership

app = typer.Typer(
    cls=Listed,
    help="Manage the benches of a centre, in its database or at the running service.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Name = Annotated[str, typer.Argument(metavar="NAME", help="1 to 20 letters, digits and . _ -")]


@app.command("add")
def add(
    name: Name,
    hall: Annotated[str | None, typer.Option(metavar="HALL", help="Where it stands.")] = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Register a bench and print its code for `calrig agent enroll`, valid once, within a day."""
    if server:
        from calrig.client.transport import part

        code = part(_client(server).post("/api/benches", {"name": name, "hall": hall}), "code")
    else:
        with _writing(db) as store:
            _, code = store.add_bench(name, hall)
    typer.echo(code)


@app.command("revoke")
def revoke(name: Name, db: Db = None, server: Server = None) -> None:
    """Revoke a bench's access and end its connections; what it measured stays."""
    if server:
        _client(server).delete(f"/api/benches/{quote(name, safe='')}")
        return
    with _writing(db) as store:
        store.revoke_bench(name)


@app.command("list")
def list_(as_json: Json = False, db: Db = None, server: Server = None) -> None:
    """List the benches, those that were revoked as well."""
    from calrig.cli.output import print_benches, print_json

    if server:
        benches = _client(server).get("/api/benches")
    else:
        from calrig.settings import store_url
        from calrig.store import Store

        with Store.open(store_url(db), writer=None) as store:
            benches = [_shown(bench) for bench in store.memberships()]
    if as_json:
        print_json(benches)
    else:
        print_benches(benches)


def _client(server: str) -> Client:
    from calrig.client import Client

    return Client(server)


@contextmanager
def _writing(db: str | None) -> Iterator[Store]:
    from calrig.settings import store_url
    from calrig.store import Store
    from calrig.store.engines import is_centre
    from calrig.store.enrolment import NO_CENTRE

    url = store_url(db)
    if not is_centre(url):  # which opening would make, where there is none
        raise InputError(NO_CENTRE)
    with Store.open(url, writer="bench") as store:
        yield store


def _shown(bench: Membership) -> dict[str, Any]:
    """As the service shows one."""
    return {
        key: value.isoformat() if isinstance(value, datetime) else value
        for key, value in asdict(bench).items()
    }
