"""A centre on the real server, a bench that is rows of its tables, and a run measured on a simulated rig."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest
from postgresql_server import MakeDatabase
from support import QUICK, running_service
from table_bench import MakeCentre, Measured, TableBench, packed
from virtual_time.clock import VirtualClock

from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.settings import RigSettings
from calrig.store import Store


@pytest.fixture(scope="session")
def measured(rig: RigSettings, tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """A calibration of unit A: six poses, completed."""
    path = tmp_path_factory.mktemp("bench") / "spool.db"
    with running_service(path, rig) as service:
        run_id = service.start(unit="A", plan=Plan.model_validate(QUICK), operator="Ada").id
        run = service.wait(run_id)
        assert run.status == "completed", run.error
        store = service.store
        return Measured(
            run,
            store.events.after(run_id),
            store.poses.of(run_id),
            store.samples.of(run_id),
            packed(service, run_id),
        )


@pytest.fixture
def url(new_database: MakeDatabase) -> str:
    """Of the centre's store, empty."""
    return new_database()


@pytest.fixture
def bench(url: str) -> Iterator[TableBench]:
    """Bench hall-2 with rig bench-1, in touch."""
    with closing(TableBench(url)) as bench:
        yield bench


@pytest.fixture
def make_centre(url: str) -> Iterator[MakeCentre]:
    """Makes services over the one store, as processes side by side are."""
    with ExitStack() as stack:

        def make(**options: Any) -> CentreService:
            store = stack.enter_context(Store.open(url, writer="tests"))
            return stack.enter_context(closing(CentreService(store, url, **options)))

        yield make


@pytest.fixture
def centre(make_centre: MakeCentre) -> CentreService:
    return make_centre()


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Goes on to the next time-out as soon as everybody waits."""
    clock = VirtualClock()
    yield clock
    clock.stop()


@pytest.fixture
def patient_centre(make_centre: MakeCentre, clock: VirtualClock) -> CentreService:
    """A centre that waits for answers by that clock."""
    return make_centre(clock=clock)


@pytest.fixture
def plan() -> Plan:
    return Plan.model_validate(QUICK)
