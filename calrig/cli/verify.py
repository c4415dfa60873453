"""`verify`: checks a unit's archive, as `export --format archive` makes it, without a store."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.options import Json
from calrig.errors import printable

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
    from calrig.cli.output import print_line

    trail = found.trail or {}
    head = trail["head"] or {"seq": 0, "sha256": "none"}
    print_line(f"{file}: intact, {found.files} files of unit {found.unit} as of {found.as_of}")
    print_line(f"{found.revisions} revisions, {found.runs} runs")
    if found.refitted:
        print_line(f"the poses give the numbers of revision {', '.join(map(str, found.refitted))}")
    for number, why in sorted(found.not_refitted.items()):
        print_line(f"revision {number} was not fitted again: {why}")
    print_line(f"{trail['entries']} entries of the trail, whose head is {head['seq']}: {head['sha256']}")
