"""`bench`: the benches of a centre, in its database or at the running service; `agent enroll`: join one."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, TYPE_CHECKING, Annotated
from urllib.parse import quote, urlsplit

import typer

from calrig.cli.exit_status import Listed
from calrig.cli.options import Config, Db, Json, Server
from calrig.cli.running_service import client_at, open_store
from calrig.errors import InputError, writable

if TYPE_CHECKING:
    from calrig.store import Store


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

        code = part(client_at(server).post("/api/benches", {"name": name, "hall": hall}), "code")
    else:
        with _writing(db) as store:
            _, code = store.enrolment.add(name, hall)
    typer.echo(code)


@app.command("revoke")
def revoke(name: Name, db: Db = None, server: Server = None) -> None:
    """Revoke a bench's access and end its connections; what it measured stays."""
    if server:
        client_at(server).delete(f"/api/benches/{quote(name, safe='')}")
        return
    with _writing(db) as store:
        store.enrolment.revoke(name)


@app.command("list")
def list_(as_json: Json = False, db: Db = None, server: Server = None) -> None:
    """List the benches, those that were revoked as well."""
    from calrig.cli.output import print_benches, show

    if server:
        from calrig.client.documents import each
        from calrig.model.service import Membership

        benches = each(Membership, client_at(server).get("/api/benches"))
    else:
        with open_store(db) as store:
            benches = store.enrolment.benches()
    show(benches, print_benches, as_json=as_json)


@contextmanager
def _writing(db: str | None) -> Iterator[Store]:
    from calrig.settings import store_url
    from calrig.store.engines import is_centre
    from calrig.store.enrolment import NO_CENTRE

    if not is_centre(store_url(db)):  # which opening would make, where there is none
        raise InputError(NO_CENTRE)
    with open_store(db, writer="bench") as store:
        yield store


def enroll(
    centre: Annotated[
        str, typer.Option(metavar="URL", help="The centre's service, such as https://calrig.lab.example.")
    ],
    code: Annotated[str, typer.Option(metavar="CODE", help="What `calrig bench add` printed.")],
    ca: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Certificates to believe, of the service and of the database."),
    ] = None,
    config: Config = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Where to keep the URL; else where `calrig agent` looks for it."),
    ] = None,
) -> None:
    """Join a centre, and keep the URL of its database, which has this bench's password, in a file."""
    from calrig.client import Client
    from calrig.client.transport import part
    from calrig.settings import centre_url_file, load_settings
    from calrig.store.benches import versions_here

    _require_private(centre)
    settings = load_settings(config)
    rigs = [] if settings.file is None else [rig.name for rig in settings.rig]
    service = Client(centre, None if ca is None else _believed(ca))
    path = out or centre_url_file()
    with _secret(path) as file:  # which can be written: the code is not spent for nothing
        mine = {"code": code, "rigs": rigs, **versions_here()}
        joined = service.post("/api/benches/enroll", mine)
        file.write(checked_by(part(joined, "db"), ca) + "\n")
    typer.echo(f"this is bench {part(joined, 'bench')} now; the URL of the centre's database is in {path}")


def _require_private(centre: str) -> None:
    """Refuses an address at which code and password could be read on the way."""
    from calrig.client.transport import is_loopback

    named = urlsplit(centre)
    if named.scheme == "http" and not is_loopback(named.hostname or ""):
        raise InputError(
            f"--centre {centre}: code and password could be read on the way: name it by https:// "
            "(`--ca FILE` where the certificate is your own authority's)"
        )


def _believed(ca: Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca)
    except OSError as error:  # no file, or none of certificates
        raise InputError(f"--ca {ca}: {error.strerror or error}") from error


def checked_by(db: str, ca: Path | None) -> str:
    """The database's URL with the certificates that its server is checked by, where it is."""
    from sqlalchemy import make_url

    url = make_url(db)
    if url.query.get("sslmode") == "verify-full":
        # libpq may not know where this machine keeps the certificates that it believes
        file = ssl.get_default_verify_paths().cafile or "system" if ca is None else ca.resolve()
        url = url.update_query_dict({"sslrootcert": str(file)})
    return url.render_as_string(hide_password=False)


@contextmanager
def _secret(path: Path) -> Iterator[IO[str]]:
    """A file that only its owner reads; it takes the place of the one before when the block ends well."""
    with writable(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = NamedTemporaryFile("w", dir=path.parent, prefix=".calrig-", delete=False)  # noqa: SIM115
    written = Path(file.name)
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        written.replace(path)
    finally:
        written.unlink(missing_ok=True)
