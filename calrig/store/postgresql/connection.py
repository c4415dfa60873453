"""Connection to PostgreSQL that is closed where the server is silent, whatever acknowledges what is sent.

TCP detects a server or a cable that has gone, but no proxy or NAT that acknowledges everything and passes
nothing on. The server's own time-outs cannot end a client's wait for an answer that does not arrive.
"""

import time
from collections.abc import Generator
from typing import Any

import psycopg
import sqlalchemy

CONNECT_S = 5
ALIVE: dict[str, Any] = {
    "connect_timeout": CONNECT_S,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
    "application_name": "calrig",
}
"""Of libpq: a server that has gone, or a cable, is noticed within half a minute."""
SILENT_S = 30.0
"""The longest that a statement may leave the server silent, but for those that rewrite tables."""
PING_S = 5.0
"""The longest silence of a server that has nothing to do but answer."""
REWRITES_S = 600.0
"""The longest silence of a server that moves a store, or brings its tables up to date."""


class Connection(psycopg.Connection[Any]):
    """One that is closed, with an error, once nothing has come and nothing could be sent for `silent_s`."""

    silent_s = SILENT_S

    def wait(self, gen: Generator[Any, Any, Any], *more: Any, **named: Any) -> Any:
        """As psycopg's, which every exchange with the server goes through."""
        return super().wait(self._heard(gen), *more, **named)

    def _heard(self, gen: Generator[Any, Any, Any]) -> Generator[Any, Any, Any]:
        try:
            wanted, heard_s = next(gen), time.monotonic()
            while True:
                ready = yield wanted
                now_s = time.monotonic()
                if ready:
                    heard_s = now_s
                elif now_s - heard_s >= self.silent_s:
                    self.close()
                    raise psycopg.OperationalError(f"the server has not answered for {self.silent_s:g} s")
                wanted = gen.send(ready)
        except StopIteration as end:
            return end.value


def connect(url: str, silent_s: float, **options: Any) -> Connection:
    """Return a connection on which each statement is a transaction.

    `options` are of libpq, in place of those of `ALIVE`.
    """
    connection = Connection.connect(url, autocommit=True, **{**ALIVE, **options})
    connection.silent_s = silent_s
    return connection


def driver_of(connection: sqlalchemy.Connection) -> Connection:
    """The connection beneath one of the store's engine."""
    driver = connection.connection.driver_connection
    assert isinstance(driver, Connection)  # noqa: S101 (as the engine makes it)
    return driver


def wait_long(connection: sqlalchemy.Connection) -> None:
    """Wait for statements that rewrite tables, until the pool has the connection again."""
    driver_of(connection).silent_s = REWRITES_S
