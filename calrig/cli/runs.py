"""`runs`: the runs of a store or a running service, newest first, narrowed by filters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal
from urllib.parse import urlencode

import typer

from calrig.cli import options
from calrig.cli.options import Db, Json, Server
from calrig.cli.running_service import open_store, running_service
from calrig.errors import InputError
from calrig.run_ids import FEWEST

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.store import Store

Query = dict[str, Any]
Page = tuple[list[Any], str | None]
"""Runs as the API gives them, and the cursor of the next page."""
MOST = 500
"""As many as the service gives on one page."""
StatusName = Literal["queued", "running", "paused", "completed", "failed", "aborted", "interrupted"]
KindName = Literal["calibration", "sweep", "verification", "static", "follow-up", "import"]
VerdictName = Literal[
    "pass",
    "conditional_pass",
    "conditional_fail",
    "fail",
    "undecided",
    "no_limits",
    "noise",
    "more_than_noise",
]


def runs(
    unit: Annotated[
        str | None, typer.Option(metavar="SERIAL", help="Serial number.", autocompletion=options.units)
    ] = None,
    rig: Annotated[str | None, typer.Option(metavar="NAME", help="Rig.", autocompletion=options.rigs)] = None,
    status: Annotated[StatusName | None, typer.Option(help="Status.")] = None,
    verdict: Annotated[
        VerdictName | None, typer.Option(help="Verdict under today's limits, or the residual.")
    ] = None,
    kind: Annotated[KindName | None, typer.Option(help="Kind.")] = None,
    text: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Part of the serial number or the note, in any case.")
    ] = None,
    since: Annotated[
        str | None,
        typer.Option("--from", metavar="TIME", help="Created at or after this day or time, in UTC."),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option("--to", metavar="TIME", help="Created before this time, or by this day, in UTC."),
    ] = None,
    begins: Annotated[
        str | None, typer.Option(metavar="ID", help="First characters of the run's id.")
    ] = None,
    follows: Annotated[
        str | None, typer.Option(metavar="RUN_ID", help="Follow-ups of this run, by its whole id.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=MOST, help="Runs at most.")] = 50,
    cursor: Annotated[
        str | None,
        typer.Option(metavar="RUN_ID", help="Continue after this run, the last of the page before."),
    ] = None,
    as_json: Json = False,
    db: Db = None,
    server: Server = None,
) -> None:
    """List runs, newest first, with the filters of the page.

    At a running service where one holds the store; else from the store, which is only read.
    """
    from calrig.cli.output import print_json, print_runs
    from calrig.client.documents import RunRecord, each

    asked = {
        "unit": unit, "rig": rig, "status": status, "verdict": verdict, "kind": kind, "q": text,
        "from": since, "to": until, "begins": begins, "follows": follows,
    }  # fmt: skip
    given: Query = {name: value for name, value in asked.items() if value is not None}
    there = running_service(server, db)
    if there is not None:
        found, next_cursor = _searched(partial(_page_there, there), given, limit, cursor)
    else:
        with open_store(db) as store:
            found, next_cursor = _searched(partial(_page_here, store), given, limit, cursor)
    if as_json:
        print_json({"items": found, "next_cursor": next_cursor})
    else:
        print_runs(each(RunRecord, found), next_cursor, is_filtered=bool(given))


def _searched(page: Callable[[Query], Page], given: Query, limit: int, cursor: str | None) -> Page:
    """Return one page; of a verdict, the service may give it in several parts."""
    found: list[Any] = []
    while True:
        part_of = {**given, "limit": str(limit - len(found))} | ({} if cursor is None else {"cursor": cursor})
        more, cursor = page(part_of)
        found += more
        if cursor is None or len(found) >= limit:
            return found, cursor


def _page_there(client: Client, query: Query) -> Page:
    from calrig.client.transport import part

    answer = client.get(f"/api/runs?{urlencode(query)}")
    return part(answer, "items"), part(answer, "next_cursor")


def _page_here(store: Store, query: Query) -> Page:
    """Return what the API answers to the same query."""
    from calrig.analysis.run_search import found_runs, moment_of
    from calrig.api.models import RunAnswer
    from calrig.store.runs import Sought

    begins = query.get("begins")
    if begins is not None and len(begins) < FEWEST:
        raise InputError(f"--begins {begins}: give at least {FEWEST} characters")
    sought = Sought(
        **{name: query.get(name) for name in ("unit", "rig", "status", "begins", "kind", "follows")},
        text=query.get("q") or None,
        since=moment_of(query.get("from"), "from"),
        before=moment_of(query.get("to"), "to"),
    )
    page = found_runs(store, sought, query.get("verdict"), int(query["limit"]), query.get("cursor"))
    return [RunAnswer.model_validate(run).model_dump(mode="json") for run in page.items], page.next_cursor
