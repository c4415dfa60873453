"""Messages for errors that PostgreSQL reports, with what to do."""

import psycopg
from psycopg import errors

from calrig.store.errors import NotText, StoreDamagedError, StoreError, StoreUnavailableError

DAMAGED = "it is damaged: go back to the newest dump (`pg_dump`) or replica"
_UNREACHABLE = "cannot be reached: check that the server runs, its address and its firewall"
_REFUSED = "the server lets nobody in under this name: check user, password and pg_hba.conf"
_RIGHTS = "permission was refused: this role may not do it (an agent's touches its own bench's rows only)"
_REMEDIES: tuple[tuple[type[Exception], type[StoreError], str], ...] = (
    (errors.DiskFull, StoreUnavailableError, "the server's disk is full: free some space"),
    (errors.TooManyConnections, StoreUnavailableError, "takes no more connections: raise max_connections"),
    (errors.LockNotAvailable, StoreUnavailableError, "another program keeps it locked: try again"),
    (errors.ReadOnlySqlTransaction, StoreUnavailableError, "the server takes no writes: is it a standby?"),
    (errors.InsufficientPrivilege, StoreError, _RIGHTS),
    (errors.InvalidAuthorizationSpecification, StoreError, _REFUSED),
    (errors.InvalidPassword, StoreError, _REFUSED),
    (errors.InvalidCatalogName, StoreError, "there is no such database: make it with `createdb`"),
    (errors.DataCorrupted, StoreDamagedError, DAMAGED),
    (errors.IndexCorrupted, StoreDamagedError, DAMAGED),
    (errors.UndefinedTable, StoreDamagedError, DAMAGED),
    (errors.UndefinedColumn, StoreDamagedError, DAMAGED),
)
_SAID_ON_CONNECTING = (
    ("does not exist", "there is no such database or user: make it with `createdb` or `createuser`"),
    ("authentication failed", _REFUSED),
    ("no pg_hba.conf entry", _REFUSED),
    ("password supplied", _REFUSED),
)
"""What a server that lets nobody in says; no code comes with it."""
_NUL = "cannot contain NUL"
"""What psycopg says of such text before the server sees it."""


def store_error(error: BaseException | None, name: str) -> StoreError:
    """What PostgreSQL reported about the database that messages call `name`."""
    said = " ".join(str(error).split())
    if isinstance(error, psycopg.DataError) and _NUL in said:
        return NotText(f"{name}: keeps no text with a NUL character in it")
    for kind, of_store, remedy in _REMEDIES:
        if isinstance(error, kind):
            return of_store(f"{name}: {remedy} ({said})")
    if isinstance(error, psycopg.OperationalError | psycopg.InterfaceError):
        for sign, remedy in _SAID_ON_CONNECTING:
            if sign in said and error.sqlstate is None:
                return StoreError(f"{name}: {remedy} ({said})")
        return StoreUnavailableError(f"{name}: {_UNREACHABLE} ({said})")
    return StoreError(f"{name}: PostgreSQL refused the work ({said})")
