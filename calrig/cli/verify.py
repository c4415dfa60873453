"""`export --format archive` makes a unit's archive; `verify` checks one, without a store."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.options import Json
from calrig.errors import InputError, WorkError, printable

if TYPE_CHECKING:
    from calrig.export.archive.check import Checked

MOST_TOLD = 50


def verify(
    file: Annotated[Path, typer.Argument(metavar="FILE.zip", help="As `export --format archive` makes it.")],
    as_json: Json = False,
) -> None:
    """Check a unit's archive: every byte, hash and link of the trail, and that poses give the numbers.

    Exit status 1 where anything is wrong, with a line each on standard error.
    """
    from calrig.cli.output import print_json
    from calrig.export.archive.check import check_archive

    found = check_archive(file)
    if as_json:
        print_json({"file": str(file), **found.to_dict()})
    elif not found.problems:
        _print(file, found)
    for where, what in found.problems[:MOST_TOLD]:
        typer.echo(f"calrig: {printable(f'{file}: {where}: {what}')}", err=True)
    if len(found.problems) > MOST_TOLD:
        typer.echo(f"calrig: {file}: and {len(found.problems) - MOST_TOLD} more", err=True)
    if found.problems:
        raise typer.Exit(1)


def _print(file: Path, found: Checked) -> None:
    from calrig.cli.printing import print_line

    trail = found.trail or {}
    head = trail["head"] or {"seq": 0, "sha256": "none"}
    print_line(f"{file}: intact, {found.files} files of unit {found.unit} as of {found.as_of}")
    print_line(f"{found.revisions} revisions, {found.runs} runs")
    if found.refitted:
        print_line(f"the poses give the numbers of revision {', '.join(map(str, found.refitted))}")
    for number, why in sorted(found.not_refitted.items()):
        print_line(f"revision {number} was not fitted again: {why}")
    print_line(f"{trail['entries']} entries of the trail, whose head is {head['seq']}: {head['sha256']}")


def export_archive(unit: str | None, out: Path | None, db: str | None) -> None:
    """Writes the archive of a unit to a file that is not there yet.

    Raises:
        InputError: no unit or file is named, or it cannot be made.
        WorkError: the disk took only a part of it, which is removed.
    """
    from calrig.analysis.archives import archive_of
    from calrig.settings import load_settings, store_url
    from calrig.store import Store

    if unit is None or out is None:
        raise InputError("export: an archive is of a unit and goes to a file: --unit SERIAL --out FILE.zip")
    with Store.open(store_url(db), writer=None) as store:
        pieces = archive_of(store, unit, load_settings().laboratory)
        try:
            file = out.open("xb")
        except FileExistsError as error:
            raise InputError(f"export: {out}: exists and is not overwritten: name another file") from error
        except OSError as error:
            raise InputError(f"export: {out}: cannot be made ({error.strerror})") from error
        try:
            with file:
                size = sum(file.write(piece) for piece in pieces)
        except BaseException as error:
            out.unlink()
            if isinstance(error, OSError):
                raise WorkError(f"{out}: cannot be written ({error.strerror})") from error
            raise
    typer.echo(f"{out}: {size / 1e6:.1f} MB")
