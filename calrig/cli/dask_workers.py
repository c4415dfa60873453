"""Workers of a Dask scheduler, or of a cluster on this machine (the extra `fleet`)."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from calrig.analysis.fleet import Workers, own_processes
from calrig.errors import WorkError

PATIENCE_S = 30.0
"""For a scheduler, and for its first worker."""


@contextmanager
def workers(scheduler: str | None) -> Iterator[Workers]:
    """Those of a scheduler; without one those of this machine, calrig's own where Dask is not installed.

    Args:
        scheduler: its address, such as `tcp://10.0.0.7:8786`.

    Raises:
        WorkError: the scheduler does not answer or has no worker, or is named and Dask is not installed.
    """
    if find_spec("distributed") is None:
        if scheduler is not None:
            raise WorkError("--scheduler needs Dask: pip install 'calrig[fleet]'")
        with own_processes() as own:
            yield own
        return
    distributed: Any = import_module("distributed")
    with ExitStack() as stack:
        if scheduler is None:
            slots = len(os.sched_getaffinity(0))
            cluster = distributed.LocalCluster(
                n_workers=slots, threads_per_worker=1, dashboard_address=None, silence_logs=logging.ERROR
            )
            client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        else:
            client = stack.enter_context(_connected(distributed, scheduler))
            slots = sum(client.ncores().values())
        executor = stack.enter_context(client.get_executor(pure=False))
        yield Workers(executor.submit, slots, f"{slots} workers of {scheduler or 'this machine'}")


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
