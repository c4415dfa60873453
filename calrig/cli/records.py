"""`import`, `backup` and `move-store`: a run into a store, a copy of a store, a store into another one."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calrig.cli import options
from calrig.cli.input_files import in_utf8, read_bytes
from calrig.cli.options import COLUMNS, Db, Json, Server, UnitSerial
from calrig.cli.running_service import open_store, running_service
from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.client import RunRecord
    from calrig.store import Run as StoredRun
    from calrig.store.sqlite.backup import BackedUp


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE.csv", help=f"Poses, one row each. {COLUMNS}")],
    unit: UnitSerial,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Rig that measured the poses; none by default.", autocompletion=options.rigs
        ),
    ] = None,
    reference_std: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Standard uncertainty of the reference angles. Default: the file's, else the rig's.",
        ),
    ] = None,
    reference_kind: Annotated[
        Literal["setting", "harmonic", "common"] | None,
        typer.Option(
            help="How the reference's error is shared: each pose anew, a smooth error of the full rotation "
            "(the default), or common to all poses."
        ),
    ] = None,
    reference_certificate: Annotated[
        str | None,
        typer.Option(metavar="NUMBER", help="Certificate that the uncertainty of --reference-std is from."),
    ] = None,
    reference: Annotated[
        Literal["good", "stage"] | None,
        typer.Option(
            help="Whose error it is in its diagnoses. good: the reference does not err, so curves of the "
            "angle are the sensor's. stage: they may be the stage's. Default: as the rig says, else stage.",
        ),
    ] = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """Import a CSV of poses as a run and print its id; its verdict goes to standard error."""
    stated = (("--reference-kind", reference_kind), ("--reference-certificate", reference_certificate))
    for option, given in stated:
        if reference_std is None and given is not None:
            raise InputError(f"{option} {given} states no uncertainty: add --reference-std DEG")
    if reference_std is not None:
        from calrig.model.result import MOST_REFERENCE_STD_DEG

        if not 0.0 < reference_std <= MOST_REFERENCE_STD_DEG:
            raise InputError(
                f"--reference-std is {reference_std:g}, not above 0 and at most {MOST_REFERENCE_STD_DEG:g}"
            )
    from calrig.cli.output import print_says

    there = running_service(server, db)
    made: RunRecord | StoredRun
    if there is not None:
        from calrig.cli.progress import late_bars

        with late_bars() as step:
            made = there.import_poses(
                file,
                unit,
                rig=rig,
                reference_std_deg=reference_std,
                reference_kind=reference_kind,
                reference_certificate=reference_certificate,
                reference=reference,
                sent=step(f"sending {file.name}"),
                told=step("importing"),
            ).record
    else:
        from calrig.analysis.amendments import Records
        from calrig.analysis.imports import ImportOrigin
        from calrig.analysis.mending import issuer_of
        from calrig.analysis.revisions import Releases
        from calrig.cli.progress import late_bar
        from calrig.settings import load_settings

        content, name = read_bytes(file), in_utf8(file.name)
        with open_store(db, writer="import") as store:
            settings = load_settings()
            issuer = issuer_of(store, settings, Releases.of(settings.rig))
            of_reference = reference_std, reference_kind, reference_certificate, reference
            origin = ImportOrigin.of(rig, settings.rig, *of_reference)
            with late_bar("importing") as told:
                made = Records(store, issuer).import_poses(
                    unit=unit, rig=rig, file_name=name, content=content, origin=origin, progress=told
                )
    typer.echo(made.id)
    print_says(made.verdict.says if made.verdict else ())


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The copy to make; never overwritten.")],
    db: Db = None,
) -> None:
    """Copy the whole store, also while a service writes to it; the copy is a store itself.

    The newest entry of the copy's audit log is entered in the audit log of the store.
    """
    from calrig.settings import store_url
    from calrig.store import StoreError, back_up

    if file.is_dir() or not file.parent.is_dir():
        raise InputError(f"backup: {file}: is a folder, or in one that is not there: name a file to make")
    if file.exists():
        raise InputError(f"backup: {file}: exists and is not overwritten: name another file")
    made = back_up(store_url(db), file)
    size_mb = made.size_bytes / 1e6
    typer.echo(f"{file}: {made.runs} runs, {made.poses} poses, {size_mb:.1f} MB")
    if made.trail_seq:
        typer.echo(f"newest entry of the audit log: {made.trail_seq}, SHA-256 {made.trail_sha256}")
        try:
            _enter_backup(made, db)
        except (WorkError, StoreError) as error:
            typer.echo(f"calrig: the backup is complete, but is not in the audit log: {error}", err=True)


def _enter_backup(made: BackedUp, db: str | None) -> None:
    """Enter a backup in the audit log, by the service that holds the store if there is one."""
    if made.trail_sha256 is None:
        return
    if (there := running_service(None, db)) is not None:
        there.post("/api/trail/backups", {"seq": made.trail_seq, "sha256": made.trail_sha256})
        return
    if not made.is_current:  # opened for writing it would be migrated
        raise WorkError("an older calrig wrote this store; `calrig serve` brings it up to date")
    with open_store(db, writer="backup") as store:
        store.trail.add_backup(made.trail_seq, made.trail_sha256)


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
