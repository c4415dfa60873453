"""What every path works on: the service, its store, the open event streams, the run that a path names."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, FastAPI, Request

from calrig.analysis.amendments import Records
from calrig.analysis.diagnoses import Diagnoses
from calrig.analysis.due_dates import INTERVAL_DAYS, DueDates, ToleranceOf, due_dates, no_tolerance
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import Histories
from calrig.analysis.issuing import Issuer
from calrig.api.looks import Looks
from calrig.processes.pool import Processes
from calrig.runs.service import RunService
from calrig.store import Run, Store, Unit


class Streams:
    """The event streams that are open, so that all of them end when the service does.

    Kept by the event that each waits for. Used in the server's event loop only.
    """

    def __init__(self) -> None:
        self.closed = False
        self.looks = Looks()
        self._waiting: set[asyncio.Event] = set()

    @contextmanager
    def joined(self, news: asyncio.Event) -> Iterator[None]:
        """Counts a stream as open; `news` is set when the service is closing."""
        self._waiting.add(news)
        try:
            yield
        finally:
            self._waiting.discard(news)

    def __len__(self) -> int:
        return len(self._waiting)

    def close(self) -> None:
        """Has every stream end: a browser that listens must not keep the service from stopping."""
        self.closed = True
        for news in self._waiting:
            news.set()


@dataclass(frozen=True)
class ApiContext:
    """The service behind the API, its store to read from, open event streams, processes for heavy work."""

    service: RunService
    store: Store
    streams: Streams = field(default_factory=Streams)
    processes: Processes = field(default_factory=Processes)
    interval_days: float = INTERVAL_DAYS
    tolerance_of: ToleranceOf = no_tolerance

    @property
    def diagnoses(self) -> Diagnoses:
        """What calibration left of stored runs."""
        return Diagnoses(self.store, self.service.issuer)

    @property
    def issuer(self) -> Issuer:
        """Drafts, releases and withdrawals of calibrations."""
        return self.service.issuer

    def due_dates(self, found: Histories | None = None) -> DueDates:
        """When each unit is due; `found` are all histories where they are known already."""
        return due_dates(self.store, found, interval_days=self.interval_days, tolerance_of=self.tolerance_of)

    @property
    def records(self) -> Records:
        """Imports and amendments."""
        return Records(self.store, self.service.issuer)


def context_of(app: FastAPI) -> ApiContext:
    """The context an application was made with."""
    context: ApiContext = app.state.context
    return context


async def _context(request: Request) -> ApiContext:
    """In the event loop: a plain function would wait for a thread, and a stop with it."""
    return context_of(request.app)


Context = Annotated[ApiContext, Depends(_context)]


def _known_run(run_id: str, context: Context) -> Run:
    """The run that the path names; a dependency, so that an unknown one is 404 before anything else."""
    return context.service.run(run_id)


KnownRun = Annotated[Run, Depends(_known_run)]


def _known_unit(serial: str, context: Context) -> Unit:
    unit = context.store.unit(serial)
    if unit is None:
        raise Unknown(f"there is no unit {serial!r}")
    return unit


KnownUnit = Annotated[Unit, Depends(_known_unit)]
