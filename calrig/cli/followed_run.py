"""A run followed by its events, at a running service or within this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING
from urllib.parse import quote

from calrig.cli.progress import LOOK_S, Notice, Refusal
from calrig.client.documents import typed
from calrig.client.errors import CONFLICT, Refused, ServiceError, Unreachable
from calrig.errors import WorkError
from calrig.model.run import Mount, Progress

if TYPE_CHECKING:
    from collections.abc import Iterator

    from calrig.client import Client, Run, RunEvent

QUEUE_LOOK_S = 3.0
"""How often a run that waits for its bench is looked at: no event tells why the bench does not take it."""


class FollowedRun:
    """A run of a client's service that this terminal has begun, and answers for, or looks at.

    Attributes:
        status, progress: as last heard.
        is_over: whether nobody carries it out any more and all that happened was told.
        has_clamp: whether the rig can turn the unit by itself.
    """

    def __init__(self, client: Client, run: Run) -> None:
        record = run.record
        self.id, self.is_over = run.id, False
        self.status: str = record.status
        self.progress = record.progress
        self.has_clamp = any(rig.clamp for rig in client.rigs() if rig.name == record.rig)
        self._client, self._run, self._rig = client, run, record.rig
        self._waits_why: str | None = None
        self._looked_at_s = time.monotonic()
        self._heard: SimpleQueue[RunEvent | Notice | Exception | None] = SimpleQueue()
        # A daemon: a line that has nothing to tell keeps nobody from leaving.
        threading.Thread(target=self._listen, name=f"events of {run.id}", daemon=True).start()

    def news(self) -> Sequence[RunEvent | Notice]:
        """Events since the last look; waits for `LOOK_S` at most."""
        events: list[RunEvent | Notice] = []
        try:
            heard = self._heard.get(timeout=LOOK_S)
            while True:
                if isinstance(heard, Exception):
                    raise heard
                if heard is None:
                    self.is_over = True
                    break
                self._take(heard)
                events.append(heard)
                heard = self._heard.get_nowait()
        except Empty:
            if self.status == "queued" and time.monotonic() - self._looked_at_s > QUEUE_LOOK_S:
                events += self._why_it_waits()
        return events

    def _why_it_waits(self) -> Sequence[Notice]:
        """What keeps it from beginning, where that is another reason than was told."""
        self._looked_at_s = time.monotonic()
        before = self._waits_why
        with suppress(Unreachable):  # told by who listens for events
            self._waits_why = self._run.look().error
        return [Notice(self._waits_why)] if self._waits_why not in (None, before) else []

    def abort(self) -> None:
        """Ends it; Refusal where it has just ended, or its stage was not seen to stand."""
        try:
            with _refusals():
                self._run.abort()
        except Unreachable as error:
            raise WorkError(
                f"run {self.id} may go on, and its stage with it: {error}; stop it at the rig"
            ) from error

    def resume(self) -> None:
        """Goes on; Refusal where the unit is not turned as it should be."""
        with _refusals():
            self._run.resume()

    def turn(self, wanted: Mount) -> None:
        """Has the rig's clamp rotate the unit; Refusal where it cannot."""
        with _refusals():
            self._client.post(
                f"/api/rigs/{quote(str(self._rig), safe='')}/clamp",
                {"mount_deg": wanted.mount_deg, "mount_axis": wanted.mount_axis},
            )

    def document(self) -> object:
        """As the API gives it."""
        return self._client.get(f"/api/runs/{self.id}")

    def _listen(self) -> None:
        try:
            for event in self._run.events(
                away=lambda why: self._heard.put(Notice(f"{why}; it is waited for, two minutes at most"))
            ):
                self._heard.put(event)
            self._heard.put(None)
        except ServiceError as error:
            self._heard.put(error)

    def _take(self, event: RunEvent | Notice) -> None:
        if event.type == "state":
            self.status = event.data["status"]
        elif event.type == "progress":
            self.progress = typed(Progress, event.data)


@contextmanager
def _refusals() -> Iterator[None]:
    try:
        yield
    except Refused as error:
        if error.status == CONFLICT:
            raise Refusal(str(error)) from error
        raise
