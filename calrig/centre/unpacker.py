"""The thread that unpacks what benches deliver; of several processes whichever comes first does."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping

from calrig.store import StoreError
from calrig.store.store import Store
from calrig.store.unpacking import Conclude, Kept

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""How often it looks though nobody said that something has come."""
AGAIN_S = 60.0
"""How often a run is tried again that could not be unpacked: what was in the way may have been mended."""


class Unpacker:
    """Unpacks until it is closed.

    Args:
        store: of the centre.
        conclude: makes results and drafts of what was completed.
    """

    def __init__(self, store: Store, conclude: Conclude) -> None:
        self._store, self._conclude = store, conclude
        self._news, self._closing = threading.Event(), False
        self._kept = Kept()
        self._said: dict[str, str] = {}
        self._again_s = time.monotonic() + AGAIN_S
        self._is_up = True
        self._thread = threading.Thread(target=self._run, name="unpacking", daemon=True)

    @property
    def stuck(self) -> Mapping[str, str]:
        """Why runs are not unpacked any further, by run."""
        return self._kept.stuck

    def start(self) -> None:
        """Begins, in its thread."""
        self._thread.start()

    def wake(self, _told: str = "") -> None:
        """Something has come."""
        self._news.set()

    def close(self) -> None:
        """Has it end, and waits until it has."""
        self._closing = True
        self._news.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._closing:
            self._news.clear()
            try:
                while not self._closing and self._some():
                    pass
                self._is_up = True
            except StoreError as error:
                if self._is_up:
                    log.error("nothing is unpacked: %s", error)
                self._is_up = False
            self._news.wait(LOOK_S)

    def _some(self) -> bool:
        """Unpacks some; returns whether there may be more."""
        if time.monotonic() >= self._again_s:
            self._again_s = time.monotonic() + AGAIN_S
            self._kept = Kept()
            self._store.settle_withdrawn()
        if not self._store.has_parcels(self._kept):
            return False
        self._kept = self._store.unpack_parcels(self._conclude, self._kept)
        for run_id, why in self._kept.stuck.items():
            if self._said.get(run_id) != why:
                log.error("run %s: a delivery is kept and cannot be unpacked: %s", run_id, why)
        self._said.update(self._kept.stuck)
        return True
