"""What every path works on: the service, its store, the open event streams, the run that a path names."""

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

from fastapi import Depends, FastAPI, Request

from calrig.analysis.amendments import Records
from calrig.analysis.diagnoses import Acceptance, Diagnoses
from calrig.analysis.due_dates import INTERVAL_DAYS, DueDates, due_dates
from calrig.analysis.error_map import Basis
from calrig.analysis.histories import Histories
from calrig.analysis.revisions import Issuer
from calrig.analysis.stored_runs import known_unit
from calrig.api.access import Attempts
from calrig.api.job import Jobs
from calrig.api.streams import ReadCache, Streams
from calrig.laboratory import LaboratorySettings
from calrig.model.solution import ErrorMap
from calrig.processes.pool import Processes
from calrig.runs.batches import RunBatches
from calrig.runs.services import Service
from calrig.runs.single_flight import SingleFlight
from calrig.settings import CentreSettings
from calrig.store import Run, Store, Unit


@dataclass(frozen=True)
class ApiContext:
    """The service behind the API, its store to read from, open event streams, processes for heavy work.

    `scans` are looks at the ports, one at a time; `jobs` heavy work that no request waits for.
    `centre` tells how agents reach a centre's database, `enrolling` counts those that try to join.
    `laboratory` is who issues certificates.
    `lately` keeps for a moment what many watch, `error_maps` by rig the last one that was solved for.
    `limits_kept_in` is the file that gives the limits; None where people change them over HTTP.
    """

    service: Service
    store: Store
    limits_kept_in: str | None = None
    streams: Streams = field(default_factory=Streams)
    processes: Processes = field(default_factory=Processes)
    interval_days: float = INTERVAL_DAYS
    scans: SingleFlight = field(default_factory=SingleFlight)
    jobs: Jobs = field(default_factory=Jobs)
    centre: CentreSettings = field(default_factory=CentreSettings)
    enrolling: Attempts = field(default_factory=Attempts)
    lately: ReadCache = field(default_factory=ReadCache)
    laboratory: LaboratorySettings = field(default_factory=LaboratorySettings)
    error_maps: dict[str, tuple[Basis, ErrorMap]] = field(default_factory=dict)

    @cached_property
    def batches(self) -> RunBatches:
        """Lists of units that are calibrated one after the other."""
        return RunBatches(self.service)

    @property
    def diagnoses(self) -> Diagnoses:
        """What calibration left of stored runs."""
        return Diagnoses(self.store)

    @property
    def issuer(self) -> Issuer:
        """Drafts, releases and withdrawals of calibrations."""
        return self.service.issuer

    def due_dates(self, found: Histories | None = None, serials: Collection[str] | None = None) -> DueDates:
        """When each unit is due, or some; `found` are all histories where they are known already."""
        return due_dates(self.store, found, serials=serials, interval_days=self.interval_days)

    @property
    def acceptance(self) -> Acceptance:
        """What of diagnoses is in force."""
        return Acceptance(self.store, self.service.issuer)

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
    return known_unit(context.store, serial)


KnownUnit = Annotated[Unit, Depends(_known_unit)]
