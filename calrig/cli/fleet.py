"""`fleet`: every completed run once more by today's catalogue."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calrig.cli.options import Db, Json
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.store import Store


def fleet(
    as_json: Json = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler; without it this machine's cores.")
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Parquet files to screen, as `export --parquet` wrote them."),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Store that takes what is found; the runs' own is only read then."),
    ] = None,
    db: Db = None,
) -> None:
    """Re-analyse every completed run with the current catalogue, and map each rig's error from its runs.

    What has been found is kept: a run is not diagnosed again in the same poses by the same catalogue.
    """
    from calrig.analysis.fleet import reanalyse
    from calrig.cli import output
    from calrig.cli.dask_workers import workers
    from calrig.cli.progress import late_bar
    from calrig.settings import store_url
    from calrig.store import Store

    with _opened(store_url(db), writes=out is None) as store:
        kept_in = nullcontext(store) if out is None else Store.open(store_url(out), writer="fleet")
        with kept_in as results:
            found = reanalyse(store, results, partial(workers, scheduler), late_bar, poses)
    if as_json:
        output.print_json(found)
    else:
        output.print_fleet(found)


def _opened(url: str, *, writes: bool) -> Store:
    from calrig.store import Store
    from calrig.store.errors import Taken

    try:
        return Store.open(url, writer="fleet" if writes else None)
    except Taken as error:
        raise WorkError(f"{error}, or keep what is found elsewhere with --out FILE") from error
