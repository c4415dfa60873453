"""`fleet`: re-analyse every completed run with the current catalogue, here or on the workers of a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli.options import Db, Json
from calrig.cli.running_service import open_store
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.analysis.fleet import Workers

KEEP_IT = "keep what is found elsewhere with --out FILE"


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
    from calrig.cli.progress import late_bar

    with open_store(db, "fleet" if out is None else None, or_else=KEEP_IT) as store:
        kept_in = nullcontext(store) if out is None else open_store(out, writer="fleet")
        with kept_in as results:
            found = reanalyse(store, results, partial(_workers, scheduler), late_bar, poses)
    output.show(found, output.print_fleet, as_json=as_json)


PATIENCE_S = 30.0
"""For a scheduler, and for its first worker."""


@contextmanager
def _workers(scheduler: str | None) -> Iterator[Workers]:
    """Those of a scheduler; without one processes of calrig's own, which hold less memory than Dask's.

    `scheduler` is its address, such as `tcp://10.0.0.7:8786`.

    Raises:
        WorkError: the scheduler does not answer or has no worker, or is named and Dask is not installed.
    """
    from calrig.analysis.fleet import Workers, own_processes

    if scheduler is None:
        with own_processes() as own:
            yield own
        return
    if find_spec("distributed") is None:
        raise WorkError("--scheduler needs Dask: pip install 'calrig[fleet]'")
    distributed: Any = import_module("distributed")
    with _connected(distributed, scheduler) as client, client.get_executor(pure=False) as executor:
        slots = sum(client.ncores().values())
        yield Workers(executor.submit, slots, f"{slots} workers of {scheduler}")


def _connected(distributed: Any, scheduler: str) -> Any:
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        raise WorkError(f"{scheduler}: no Dask scheduler answers there ({error})") from error
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError as error:
        client.close()
        said = f"has no worker: start `dask worker {scheduler}` where calrig is installed"
        raise WorkError(f"{scheduler}: {said}") from error
    return client
