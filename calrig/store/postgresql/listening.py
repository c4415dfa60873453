"""Thread that receives notifications of the database (`set_up`) and reconnects after a loss."""

import logging
import threading
import time
from collections.abc import Callable, Mapping

import psycopg
from psycopg import sql

from calrig.store.postgresql.connection import PING_S, Connection, connect
from calrig.store.postgresql.database import url_of

log = logging.getLogger(__name__)

LOOK_S = 0.2
"""How soon it notices that it is to end: a connection is not closed under the thread that reads it."""
AGAIN_S = 1.0
"""Between two attempts to connect."""


class Listening:
    """Listens until it is closed.

    Args:
        heard: what is called with the payload of each notification, by channel. It is to be quick, and to
            look for itself what has happened: anybody may notify.
        connected: called whenever it listens anew. What was told before then was not heard.
    """

    def __init__(
        self,
        url: str,
        heard: Mapping[str, Callable[[str], object]],
        connected: Callable[[], object] = lambda: None,
    ) -> None:
        self._url = url_of(url).set(drivername="postgresql").render_as_string(hide_password=False)
        self._heard, self._connected = heard, connected
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="listening", daemon=True)

    def start(self) -> None:
        """Begins to listen, in its thread."""
        self._thread.start()

    def close(self) -> None:
        """Has it end, and waits until it has."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        said = False
        while not self._closing.is_set():
            try:
                with connect(self._url, PING_S) as connection:
                    for channel in self._heard:
                        connection.execute(sql.SQL("LISTEN {}").format(sql.Identifier(channel)))
                    if said:
                        log.info("the database tells of news again")
                    said = False
                    self._call(self._connected)
                    self._listen(connection)
            except psycopg.Error as error:
                if not said:
                    log.warning("the database tells of no news, and is asked again: %s", error)
                said = True
                self._closing.wait(AGAIN_S)

    def _listen(self, connection: Connection) -> None:
        ping_at_s = time.monotonic() + PING_S
        while not self._closing.is_set():
            if time.monotonic() >= ping_at_s:
                connection.execute("SELECT")
                ping_at_s = time.monotonic() + PING_S
            for told in connection.notifies(timeout=LOOK_S):
                heard = self._heard.get(told.channel)
                if heard is not None:
                    self._call(heard, told.payload)
                if self._closing.is_set():
                    return

    def _call(self, heard: Callable[..., object], *payload: str) -> None:
        try:
            heard(*payload)
        except Exception:
            log.exception("what the database told was not taken up")
