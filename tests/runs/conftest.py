"""A store for the session, rigs that end with their test, and services over them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from postgresql_server import store_at
from run_rigs import CLOCK, TruthRig

from calrig.runs.service import RunService
from calrig.store import Store


@pytest.fixture(scope="session", autouse=True)
def _time_stands() -> Iterator[None]:
    """Until a test waits for something: so it acts at the very instant that it waited for."""
    with CLOCK.taking_part():
        yield
    CLOCK.stop()


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    """One store for all runs of this folder: each test looks at its own runs only."""
    path = tmp_path_factory.mktemp("runs") / "calrig.db"
    with Store.open(store_at(path), writer="tests") as opened:
        yield opened


@pytest.fixture
def make_rig() -> Iterator[Callable[..., TruthRig]]:
    """Switches rigs on; they end with the test."""
    with ExitStack() as stack:

        def make(name: str = "bench-1", **options: Any) -> TruthRig:
            rig = TruthRig(name, **options)
            stack.enter_context(rig.simulated)
            return rig

        yield make


@pytest.fixture
def serve(store: Store) -> Iterator[Callable[..., RunService]]:
    """Makes services over the session's store; they are closed before the rigs are switched off."""
    with ExitStack() as stack:

        def make(*rigs: TruthRig) -> RunService:
            service = RunService(store, [rig.settings for rig in rigs])
            stack.callback(service.close)
            return service

        yield make


@pytest.fixture
def bench(make_rig: Callable[..., TruthRig]) -> TruthRig:
    """One fast rig without errors but a mount offset of 0.8° and a gyro bias."""
    return make_rig()


@pytest.fixture
def service(bench: TruthRig, serve: Callable[..., RunService]) -> RunService:
    """A service with the one rig."""
    return serve(bench)
