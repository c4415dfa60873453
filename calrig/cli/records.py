"""`import`, `backup` and `move-store`: a run into a store, a copy of a store, a store into another one."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.input_files import in_utf8, read_bytes
from calrig.cli.options import COLUMNS, Db, Json, Rig, Server, UnitSerial
from calrig.cli.running_service import running_service
from calrig.errors import InputError

if TYPE_CHECKING:
    from calrig.client import Client, Run


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help=f"Poses, one row each. {COLUMNS}")],
    unit: UnitSerial,
    rig: Rig = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Import a CSV of poses as a run and print its id; its verdict goes to standard error."""
    there = running_service(server, db)
    if there is not None:
        from calrig.cli.output import print_says

        record = _imported_there(there, file, unit, rig).record
        typer.echo(record.id)
        print_says(record.verdict.says if record.verdict else ())
        return

    from calrig.analysis.amendments import Records
    from calrig.analysis.limits import keep_configured
    from calrig.analysis.revisions import Issuer, Releases
    from calrig.cli.output import print_says
    from calrig.cli.progress import late_bar
    from calrig.settings import load_settings, store_url
    from calrig.store import Store

    content = read_bytes(file)
    name = in_utf8(file.name)
    with Store.open(store_url(db), writer="import") as store:
        settings = load_settings()
        keep_configured(settings, store)
        issuer = Issuer(store, Releases.of(settings.rig))
        issuer.bring_over()
        with late_bar("importing") as told:
            made = Records(store, issuer).import_poses(
                unit=unit, rig=rig, file_name=name, content=content, progress=told
            )
    typer.echo(made.id)
    if made.verdict is not None:
        print_says(made.verdict.says)


def _imported_there(client: Client, file: Path, unit: str, rig: str | None) -> Run:
    from calrig.cli.progress import late_bars

    with late_bars() as step:
        sent, told = step(f"sending {file.name}"), step("importing")
        return client.import_poses(file, unit, rig=rig, sent=sent, told=told)


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The copy to make; never overwritten.")],
    db: Db = None,
) -> None:
    """Copy the whole store, also while a service writes to it; the copy is a store itself."""
    from calrig.settings import store_url
    from calrig.store import back_up

    if file.is_dir() or not file.parent.is_dir():
        raise InputError(f"backup: {file}: is a folder, or in one that is not there: name a file to make")
    if file.exists():
        raise InputError(f"backup: {file}: exists and is not overwritten: name another file")
    made = back_up(store_url(db), file)
    size_mb = made.size_bytes / 1e6
    typer.echo(f"{file}: {made.runs} runs, {made.poses} poses, {size_mb:.1f} MB")


Named = Annotated[
    str, typer.Argument(metavar="FROM", help="The store to take over: a path or a URL; it is not changed.")
]
Into = Annotated[str, typer.Argument(metavar="TO", help="An empty store, made where there is none.")]


def move_store(from_: Named, to: Into, json: Json = False) -> None:
    """Copy a whole store into an empty one, from SQLite to PostgreSQL or back, and compare the two.

    Every checksum is verified on the way; TO has all of it or, where anything goes wrong, nothing.
    """
    from calrig.cli.output import print_json, print_moved, print_says
    from calrig.cli.progress import late_bar
    from calrig.settings import store_url
    from calrig.store.moving import move_store as move

    with late_bar("moving the store") as told:
        moved = move(store_url(from_), store_url(to), told)
    print_says(moved.says)
    if json:
        print_json({"tables": [asdict(t) for t in moved.tables], "duration_s": moved.duration_s})
    else:
        print_moved(moved)
