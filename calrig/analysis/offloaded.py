"""Work on a store in a process for heavy work, which opens the store for itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from calrig.store import Store

T = TypeVar("T")


def with_store(url: str, work: Callable[[Store], T]) -> T:
    """Return what the work gives for a store, opened for reading and closed again.

    `url` is as `Store.open` takes it; `work` is of a module, or a `partial` of one, so that another process
    can be given it.

    Raises:
        StoreError: as of `Store.open`.
    """
    with Store.open(url, writer=None) as store:
        return work(store)
