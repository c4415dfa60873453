"""Rigs and services as tests use them: simulated devices in virtual time, a real store, real HTTP."""

from __future__ import annotations

import faulthandler
import gc
import os
import sys

# Keep what was compiled, although images of containers often forbid it. Otherwise each worker compiles all
# tests, half of its work before its first test, and each program that a test starts compiles calrig.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False

# A worker has a core: with a thread a core in each, a third of the time goes into waiting for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from empty_store import in_a_hurry
from hypothesis import HealthCheck, settings
from postgresql_server import (  # noqa: F401 (fixtures)
    _stores_are_databases,
    new_database,
    on_a_server,
    postgresql_server,
    postgresql_template,
)
from shared_processes import in_shared_process
from support import QUICK, fast, known_as, running_service, serving
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.analysis import stored_runs, unit_of_work
from calrig.plan import Plan
from calrig.runs import follow_up
from calrig.settings import RigSettings

# A busy machine is no failure, and a run repeats alike; `--hypothesis-profile=explore` tries new examples.
settings.register_profile(
    "calrig", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("calrig")

LaunchRig = Callable[..., RigSettings]
STUDIES = Path(__file__).parent / "studies"
ENDS_S = 30.0
"""How long a process of tests may take to end."""
MOST_SPEED = 10.0
"""Of rigs that people watch: a run that nobody waits for leaves the processor to the test."""


def pytest_configure(config: pytest.Config) -> None:
    """Has files handed out in the order below, where pytest-xdist would begin with those of most tests."""
    config.option.loadscopereorder = False


def pytest_xdist_auto_num_workers() -> int:
    """One worker more than there are cores: a test that waits leaves its core to another one."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(tryfirst=True)  # before the marks are chosen from
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks what needs a PostgreSQL server, and all studies, which are a step of their own in `.ci/run`.

    The page's files, few and long, come first: no worker idles.
    """
    for item in items:
        if STUDIES in item.path.parents:
            item.add_marker("statistical")
        if on_a_server(item):
            item.add_marker("centre")
    items.sort(key=lambda item: item.get_closest_marker("browser") is None)


def pytest_collection() -> None:
    """To look for garbage in what is imported takes a tenth of that."""
    gc.disable()


def pytest_collection_finish() -> None:
    """What was imported stays as long as the worker: the garbage collector need not look at it ever again."""
    gc.freeze()
    gc.enable()


def pytest_unconfigure(config: pytest.Config) -> None:
    """A thread that keeps this process from ending is shown, and is ended with it.

    A worker of pytest-xdist that is done waits for the others, and is ended by who began it.
    """
    if not hasattr(config, "workerinput"):
        faulthandler.dump_traceback_later(ENDS_S, exit=True)


@pytest.fixture(scope="session", autouse=True)
def _processes_are_shared() -> Iterator[None]:
    """Fits of what is accepted, and follow-ups, run in processes that serve all tests of a worker."""
    with pytest.MonkeyPatch.context() as patched:
        for module in (unit_of_work, stored_runs, follow_up):
            patched.setattr(module, "run_in_subprocess", in_shared_process)
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_power_is_cut() -> Iterator[None]:
    with in_a_hurry():
        yield


@pytest.fixture(scope="session")
def launch_rig() -> Iterator[LaunchRig]:
    """Simulated rigs in virtual time: `launch_rig("bench-2", stage={"fault": "garbage"})`, over FAST.

    Their ports (`sim://…`) are there for this process alone.
    """
    clock = VirtualClock(MOST_SPEED)
    with ExitStack() as rigs:
        rigs.callback(clock.stop)

        def start(name: str = "bench-1", **options: Any) -> RigSettings:
            simulated = rigs.enter_context(virtual_rig(fast(options), clock))
            return known_as(name, simulated).model_copy(update={"simulated": {}})

        yield start


@pytest.fixture(scope="session")
def rig(launch_rig: LaunchRig) -> RigSettings:
    """One fast simulated rig, `bench-1`, shared by the tests of a session."""
    return launch_rig()


@pytest.fixture
def quick_plan() -> Plan:
    """Six poses, done in less than a second on the fast rig."""
    return Plan.model_validate(QUICK)


@pytest.fixture
def store_path(tmp_path: Path) -> Path:
    """Where a test's store lies."""
    return tmp_path / "calrig.db"


@pytest.fixture
def service(rig: RigSettings, store_path: Path) -> Iterator[Any]:
    """A run service with the fast rig over a fresh store."""
    with running_service(store_path, rig) as service:
        yield service


@pytest.fixture
def client(service: Any) -> Iterator[httpx.Client]:
    """A client of the real application with the fast rig; `client.base_url` is its address."""
    with serving(service) as client:
        yield client


@pytest.fixture(scope="module")
def shared_client(rig: RigSettings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """As `client`, with one server and store for all tests of a module: for those that leave no trace."""
    path = tmp_path_factory.mktemp("shared") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        yield client
