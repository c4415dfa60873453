"""`verify`: checks a unit's archive or a backup by itself, and a store's audit log by them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli.options import Json
from calrig.cli.running_service import open_store
from calrig.errors import printable, readable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calrig.export.archive.check import Checked, Problem

MOST_TOLD = 50
_STORE_BEGINS = b"SQLite format 3\0"


def verify(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="As `export --format archive` or `backup` makes it.")
    ],
    db: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="A store whose audit log must have the newest entry of FILE."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check a unit's archive: every byte, hash and link of the trail, and that poses give the numbers.

    Of a backup, the links of its audit log are checked. Exit status 1 where anything is wrong, with a line
    each on standard error.
    """
    from calrig.cli.output import print_json
    from calrig.export.archive.check import check_archive

    found = _check_backup(file) if _is_store(file) else check_archive(file)
    if db is not None and found.trail is not None:
        found.problems += _missing_in_store(db, found.trail["head"])
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


def _is_store(file: Path) -> bool:
    with readable(file), file.open("rb") as opened:
        return opened.read(len(_STORE_BEGINS)) == _STORE_BEGINS


def _check_backup(file: Path) -> Checked:
    from calrig.export.archive.check import Checked

    with open_store(str(file)) as backup:
        (seq, sha256), broken_at = backup.trail.head(), backup.trail.broken_link()
    trail = {"entries": seq, "head": {"seq": seq, "sha256": sha256} if seq else None, "broken_at": broken_at}
    problems = [] if broken_at is None else [("audit log", f"is broken at entry {broken_at}")]
    return Checked(problems, trail=trail)


def _missing_in_store(db: str, head: Mapping[str, Any] | None) -> list[Problem]:
    """What is wrong with a store's audit log: it must go on from an entry of before."""
    where = f"audit log of {db}"
    with open_store(db) as store:
        broken_at = store.trail.broken_link()
        problems = [] if broken_at is None else [(where, f"is broken at entry {broken_at}")]
        if head is not None and not store.trail.holds(head["seq"], head["sha256"]):
            problems.append((where, f"lacks entry {head['seq']}, SHA-256 {head['sha256']}, or has another"))
    return problems


def _print(file: Path, found: Checked) -> None:
    from calrig.cli.output import print_line

    trail = found.trail or {}
    head = trail["head"] or {"seq": 0, "sha256": "none"}
    if found.unit is None:
        print_line(f"{file}: a backup, its audit log is intact")
    else:
        print_line(f"{file}: intact, {found.files} files of unit {found.unit} as of {found.as_of}")
        print_line(f"{found.revisions} revisions, {found.runs} runs")
    if found.refitted:
        print_line(f"the poses give the numbers of revision {', '.join(map(str, found.refitted))}")
    for number, why in sorted(found.not_refitted.items()):
        print_line(f"revision {number} was not fitted again: {why}")
    print_line(f"{trail['entries']} entries of the trail, whose head is {head['seq']}: {head['sha256']}")
