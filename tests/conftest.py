"""Rigs and services as tests use them: simulated devices behind real ports, a real store, real HTTP."""

from __future__ import annotations

import os

# A worker has a core: with a thread a core in each, a third of the time goes into waiting for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from support import FAST, QUICK, running_service, serving

from calrig.plan import Plan
from calrig.settings import BoardSettings, ReferenceSettings, RigSettings, StageSettings

LaunchRig = Callable[..., RigSettings]


@pytest.fixture(scope="session")
def launch_rig() -> Iterator[LaunchRig]:
    """Starts simulated rigs: `launch_rig("bench-2", stage={"fault": "garbage"})`, over the FAST options."""
    from calrig.simulator.launch import launch

    with ExitStack() as processes:

        def start(name: str = "bench-1", **options: Any) -> RigSettings:
            merged = dict(FAST)
            for key, value in options.items():
                merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
            process = processes.enter_context(launch(merged))
            return RigSettings(
                name=name,
                stage=StageSettings(driver="smc100", port=process.stage_port),
                imu=BoardSettings(driver="calrig", port=process.imu_port),
                reference=ReferenceSettings(std_deg=0.29),
                simulated={},
            )

        yield start


@pytest.fixture(scope="session")
def rig(launch_rig: LaunchRig) -> RigSettings:
    """One fast simulated rig, `bench-1`, shared by the tests of a session."""
    return launch_rig()


@pytest.fixture
def quick_plan() -> Plan:
    """Six poses, done in about a second on the fast rig."""
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
