"""Runs that this process carries out, or that another program writes into the store."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

from calrig.cli.progress import LOOK_S, Refusal
from calrig.errors import WorkError

if TYPE_CHECKING:
    from calrig.model.plan import MountAxis
    from calrig.runs.service import RunService
    from calrig.store import Event, Run, Store


class RunHere:
    """A run of the service in this process; `calrig.cli.progress.Followed` has what each part is."""

    def __init__(self, service: RunService, run: Run) -> None:
        self.id, self.is_over = run.id, False
        self.status, self.progress = str(run.status), run.progress.model_dump()
        self.has_clamp = any(state.clamp for state in service.rigs() if state.name == run.rig)
        self._service, self._rig, self._seen = service, str(run.rig), 0
        self._heard = threading.Event()
        # it ends with the service, which nothing outlives here
        service.bus.subscribe(run.id, self._heard.set)

    def news(self) -> Sequence[Event]:
        """Events since the last look."""
        from calrig.model.run import AT_REST

        self._heard.wait(LOOK_S)
        self._heard.clear()
        run = self._service.run(self.id)  # before the events: where it has ended, these are all of them
        events = self._service.store.events_after(self.id, self._seen)
        self._seen = events[-1].seq if events else self._seen
        self.status, self.progress = str(run.status), run.progress.model_dump()
        self.is_over = run.status in AT_REST
        return events

    def abort(self) -> None:
        """Ends it."""
        with _refusals():
            self._service.abort(self.id)

    def resume(self) -> None:
        """Goes on."""
        with _refusals():
            self._service.resume(self.id)

    def turn(self, mount_deg: float, mount_axis: str) -> None:
        """Has the rig's clamp turn the unit."""
        with _refusals():
            self._service.begin_clamp(self._rig, mount_deg, cast("MountAxis", mount_axis)).result()

    def document(self) -> dict[str, Any]:
        """As the API gives it."""
        return document_of(self._service.run(self.id))


class RunElsewhere:
    """A run that another program carries out into the same file; as `calrig.cli.progress.Watched`.

    `is_written` tells whether a program writes to that file.
    """

    def __init__(self, store: Store, run: Run, is_written: Callable[[], bool]) -> None:
        self.id, self.is_over = run.id, False
        self.status, self.progress = str(run.status), run.progress.model_dump()
        self._store, self._seen, self._is_written = store, 0, is_written

    def news(self) -> Sequence[Event]:
        """Events since the last look.

        Raises:
            WorkError: nobody carries it out any more.
        """
        from calrig.analysis.stored_runs import stored_run
        from calrig.model.run import AT_REST

        is_written = self._is_written()  # before the run is read: who has ended it may be gone
        run = stored_run(self._store, self.id)
        if run.status not in AT_REST and not is_written:
            raise WorkError(
                f"run {self.id} is {run.status} in the store, and no program is there that carries it out; "
                f"`calrig resume {self.id}` goes on with it"
            )
        events = self._store.events_after(self.id, self._seen)
        self._seen = events[-1].seq if events else self._seen
        self.status, self.progress = str(run.status), run.progress.model_dump()
        self.is_over = run.status in AT_REST
        if not events and not self.is_over:
            time.sleep(LOOK_S)
        return events

    def document(self) -> dict[str, Any]:
        """As the API gives it."""
        from calrig.analysis.stored_runs import stored_run

        return document_of(stored_run(self._store, self.id))


def document_of(run: Run) -> dict[str, Any]:
    """A run of the store as the API gives it."""
    from calrig.api.models import RunAnswer

    return RunAnswer.model_validate(run).model_dump(mode="json")


@contextmanager
def ends_told_once() -> Iterator[None]:
    """Keeps the log from telling how a run ends: where there is a terminal, the command does."""
    log = logging.getLogger("calrig.runs.recorder")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


@contextmanager
def _refusals() -> Iterator[None]:
    from calrig.analysis.errors import Conflict

    try:
        yield
    except Conflict as error:
        raise Refusal(str(error)) from error
