"""A store in a file of its own, and what fills it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from empty_store import lay_empty_store
from rich_store import fill

from calrig.store import Run, Store


@pytest.fixture
def database(tmp_path: Path) -> Path:
    return tmp_path / "calrig.db"


@pytest.fixture
def url(database: Path) -> str:
    return f"sqlite:///{database}"


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """What holds of a store holds on every engine; what is about a file, on that of files."""
    if "engine" in metafunc.fixturenames:
        of_a_file = {"database", "url"}.intersection(metafunc.fixturenames)
        metafunc.parametrize("engine", ["sqlite"] if of_a_file else ["sqlite", "postgresql"])


@pytest.fixture
def store(engine: str, request: pytest.FixtureRequest) -> Iterator[Store]:
    if engine == "postgresql":
        url = request.getfixturevalue("new_database")()
    else:
        url = request.getfixturevalue("url")
        lay_empty_store(request.getfixturevalue("database"))
    with Store.open(url, writer="test") as opened:
        yield opened


@pytest.fixture
def new_run(store: Store) -> Callable[..., Run]:
    """Makes a running run of unit A on rig bench; any argument can be given."""

    def make(**given: Any) -> Run:
        return store.runs.create(
            **{"unit": "A", "rig": "bench", "plan": None, "status": "running", "provenance": {}, **given}
        )

    return make


@pytest.fixture
def result() -> dict[str, Any]:
    return {
        "bias_deg": 0.25,
        "bias_std_deg": 0.004,
        "scale": 1.002,
        "scale_std": 0.0001,
        "rms_raw_deg": 0.26,
        "rms_calibrated_deg": 0.03,
        "rms_with_effects_deg": None,
        "n_poses": 52,
        "noise_deg": 0.02,
        "temperature_c": {"min": 21.5, "max": 24.0},
        "gyro": {
            "bias_dps": [0.1, -0.2, 0.3],
            "bias_std_dps": [0.01] * 3,
            "scale": 1.001,
            "scale_std": 1e-4,
        },
    }


@pytest.fixture(scope="session")
def rich_and_token(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    path = tmp_path_factory.mktemp("rich") / "calrig.db"
    return path, fill(path)


@pytest.fixture
def rich(rich_and_token: tuple[Path, str]) -> Path:
    """A store that is not changed."""
    return rich_and_token[0]


@pytest.fixture
def source(rich: Path, tmp_path: Path) -> Path:
    """A store of one's own to spoil."""
    return Path(shutil.copy(rich, tmp_path / "source.db"))
