"""Which running service a command speaks to: the one that is named, else the one that holds the store.

Where none does, the command opens the store itself.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from calrig.cli.options import LISTED, the_one
from calrig.errors import WorkError
from calrig.run_ids import begins_uuid, is_uuid

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.store import Store

NAMED = "CALRIG_SERVER"


def running_service(server: str | None, db: str | None) -> Client | None:
    """The service to ask, with CALRIG_TOKEN; None where this process does the work on the store itself.

    Args:
        server: its address, as an option or CALRIG_SERVER gave it. A store named by `--db` goes before the
            variable.
        db: the store, as `--db` gave it. Whoever serves it has left the address in its lock; what is
            another user's, or could have been written by one, is not asked.

    Raises:
        InputError: `server` is no address.
    """
    if server and is_named(server, db):
        return client_at(server)
    from calrig.settings import store_url
    from calrig.store.engines import is_centre
    from calrig.store.sqlite.database import database_path
    from calrig.store.sqlite.lock import answering_at

    url = store_url(db)
    address = None if is_centre(url) else answering_at(database_path(url))
    return None if address is None else client_at(address)


def is_named(server: str | None, db: str | None) -> bool:
    """Whether a service was named to be asked; a store named by `--db` goes before the variable."""
    return bool(server) and not (db and server == os.environ.get(NAMED))


def whole_id_there(client: Client, typed: str) -> str:
    """As `calrig.cli.options.whole_id`, of the runs that a service has."""
    if is_uuid(typed) or not begins_uuid(typed.lower()):
        return typed
    return the_one(typed, [run.id for run in client.runs(begins=typed.lower(), limit=LISTED + 1)])


def client_at(address: str) -> Client:
    """A client of the service at an address, with CALRIG_TOKEN."""
    from calrig.client import Client

    return Client(address)


def open_store(
    db: str | None, writer: str | None = None, *, or_else: str | None = None, or_ask: str | None = None
) -> Store:
    """The store of `--db`: opened for reading, or by the command that writes.

    `or_else` is what else helps where another program writes to it, `or_ask` where that one serves it.
    """
    from calrig.settings import store_url
    from calrig.store import Store
    from calrig.store.errors import Taken

    try:
        return Store.open(store_url(db), writer=writer)
    except Taken as error:
        instead = (or_ask if error.is_served else None) or or_else
        if instead is None:
            raise
        raise WorkError(f"{error}, or {instead}") from error
