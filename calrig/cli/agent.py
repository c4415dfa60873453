"""`agent`: carries out the runs of this machine's rigs for a centre, until a signal ends it."""

from __future__ import annotations

import os
import threading
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calrig
from calrig.cli.exit_status import Listed
from calrig.cli.options import Config, LogFormat, Record
from calrig.cli.serve import url_of
from calrig.cli.start import loaded
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    import socket

    from calrig.api.access import Access
    from calrig.runs.service import RunService

app = typer.Typer(
    cls=Listed,
    help="Carry out the runs of this machine's rigs for a centre.",
    invoke_without_command=True,
)

SPOOL = "spool.db"


@app.callback()
def agent(
    context: typer.Context,
    db: Annotated[
        str | None, typer.Option(metavar="URL", help="The centre's database [CALRIG_DB, or as enrolled].")
    ] = None,
    db_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A file with that URL, which keeps its password from others."),
    ] = None,
    config: Config = None,
    spool: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Keeps what is not delivered; without it in the data folder."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=0, max=65535, help="Serves the bench's own page there; 0: any free port."
        ),
    ] = None,
    host: Annotated[str, typer.Option(metavar="H", help="Address that the page listens on.")] = "127.0.0.1",
    record: Record = None,
    log_format: LogFormat = None,
) -> None:
    """Carry out the runs of this machine's rigs for a centre.

    Without the centre it finishes what it has begun, keeps it, and delivers it later; its page starts, stops
    and shows runs as ever. CALRIG_TOKEN is the token that the page asks for.
    """
    if context.invoked_subcommand is not None:
        return
    from calrig.api.access import access_here
    from calrig.api.server import address_of, listen
    from calrig.cli.local_service import local_service
    from calrig.logs import configure_log
    from calrig.settings import load_settings

    url, settings = _checked_url(_centre_url(db, db_file)), load_settings(config)
    configure_log(log_format)
    access = None if port is None else access_here(host, address_of(host, port), settings)
    with (
        nullcontext() if port is None else closing(listen(host, port)) as listener,
        local_service(_spool_url(spool), "agent", settings.rig, settings, record, drafts=False) as service,
        suppress(KeyboardInterrupt),
    ):
        _work(service, url, listener, access)


def _centre_url(db: str | None, db_file: Path | None) -> str:
    """Return the URL of the centre's database: as named, or as `calrig agent enroll` has left it.

    Raises:
        InputError: two URLs are named, or a file that cannot be read.
    """
    from calrig.settings import centre_url_file, store_url

    if db_file is not None and db:
        raise InputError("--db and --db-file both name the centre's database: leave one of them out")
    kept = db_file or centre_url_file()
    if db_file is None and (db or os.environ.get("CALRIG_DB") or not kept.is_file()):
        _warn_of_password(db)
        return store_url(db)
    try:
        return kept.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{kept}: cannot be read as the URL of the centre's database ({error})") from error


def _warn_of_password(db: str | None) -> None:
    from sqlalchemy import make_url

    from calrig.store.engines import is_centre

    if db is None or not is_centre(db):
        return
    url = make_url(db)
    if url.password is not None or "password" in url.query:
        typer.echo(
            "calrig: warning: --db contains a password, and everybody on this machine can read the arguments "
            "of programs: name the URL in CALRIG_DB or by --db-file FILE, or join by `calrig agent enroll`",
            err=True,
        )


def _checked_url(url: str) -> str:
    """The URL of a centre's database in libpq's own form.

    Raises:
        InputError: it names none.
        WorkError: by it somebody on the network could listen, or take the centre's place.
    """
    from sqlalchemy import make_url

    from calrig.store.engines import EXTRA, is_centre

    if not is_centre(url):
        raise InputError("an agent needs the URL of its centre's database: --db postgresql+psycopg://…")
    try:
        from calrig.store.postgresql.set_up import is_on_this_machine
    except ModuleNotFoundError as error:
        raise WorkError(f"an agent needs {error.name}: {EXTRA}") from error
    parsed = make_url(url)
    if not is_on_this_machine(parsed) and parsed.query.get("sslmode") != "verify-full":
        shown = parsed.set(drivername="postgresql+psycopg").render_as_string(hide_password=True)
        raise WorkError(
            f"{shown}: a centre on another machine is reached by TLS that proves who it is: add "
            "?sslmode=verify-full (and sslrootcert=FILE) to the URL"
        )
    return parsed.set(drivername="postgresql").render_as_string(hide_password=False)


def _spool_url(spool: str | None) -> str:
    """The spool's URL; CALRIG_DB names the centre's database here."""
    import platformdirs

    from calrig.settings import store_url

    return store_url(spool or str(platformdirs.user_data_path("calrig", ensure_exists=True) / SPOOL))


def _work(service: RunService, url: str, listener: socket.socket | None, access: Access | None) -> None:
    """Works for the centre, and serves the bench's own page where that was asked for."""
    from calrig.agent.agent import Agent
    from calrig.agent.link import is_of_owner

    if is_of_owner(url):
        raise InputError(
            "the URL logs in as the owner of the centre's database, and an agent needs its bench's role: "
            "add it at the centre (`calrig bench add NAME`) and join by `calrig agent enroll`"
        )

    rigs = ", ".join(state.name for state in service.rigs())
    with closing(Agent(service, url)) as at_work:
        at_work.start()
        if listener is None or access is None:
            loaded()
            typer.echo(f"calrig {calrig.__version__}, rigs: {rigs}")
            threading.Event().wait()
            return
        from calrig.api.app import create_app, what_is_asked
        from calrig.api.server import Server

        app = create_app(service, access=access, is_bench=True)
        host, port = listener.getsockname()[:2]
        said = f"calrig {calrig.__version__} at {url_of(host, port)}, rigs: {rigs}{what_is_asked(app)}"
        loaded()
        Server(app, lambda: typer.echo(said)).run(sockets=[listener])
