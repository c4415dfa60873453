"""A store that fails in a run: the stage stops, what was announced stays, the service goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from postgresql_server import store_at
from run_rigs import TruthRig, begin, events, plan, until
from sqlalchemy import event

from calrig.runs.service import RunService
from calrig.store import Store


@contextmanager
def hindered(store: Store, pragma: str, lifted: str) -> Iterator[None]:
    """As long as it lasts, every connection of the store has the limit that the pragma sets."""
    engine = store._database._engine
    wanted = [pragma]

    def limit(connection, *_):
        connection.execute(f"PRAGMA {wanted[0]}")

    event.listen(engine, "checkout", limit)
    try:
        yield
    finally:
        wanted[0] = lifted


FULL = ("max_page_count = 1", "max_page_count = 1073741823", "the disk is full: free some space")
READ_ONLY = ("query_only = ON", "query_only = OFF", "read-only: make both writable")


@pytest.fixture
def own_service(bench: TruthRig, tmp_path: Path) -> Iterator[RunService]:
    with Store.open(store_at(tmp_path / "calrig.db"), writer="tests") as store:
        service = RunService(store, [bench.settings])
        yield service
        service.close()


@pytest.mark.parametrize(("pragma", "lifted", "reason"), [FULL, READ_ONLY], ids=["full", "read-only"])
def test_a_store_that_refuses_stops_the_stage_and_fails_the_run_with_the_reason(
    bench: TruthRig,
    own_service: RunService,
    caplog: pytest.LogCaptureFixture,
    pragma: str,
    lifted: str,
    reason: str,
) -> None:
    store = own_service.store
    run = begin(own_service, plan(sweeps=200, dwell_s=4.0))
    until(lambda: store.poses.count(run.id) >= 2, "two poses")
    with hindered(store, pragma, lifted):
        announced = [e.data["index"] for e in events(store, run, "pose")]
        ended = until(lambda: (r := own_service.run(run.id)).status == "failed" and r, "end of the run")
        assert reason in (ended.error or "")
        assert bench.stands_for_good()
        assert own_service.rigs()[0].state == "idle"

    told = until(lambda: (r := store.runs.get(run.id)) and r.status == "failed" and r, "end in the store")
    assert reason in (told.error or "")
    assert [p.index for p in store.poses.of(run.id)][: len(announced)] == announced
    assert events(store, run)[-1].data["status"] == "failed"
    again = own_service.wait(begin(own_service, plan()).id, 30)
    assert again.status == "completed", "the service goes on without a restart"


def test_a_service_told_to_go_does_not_wait_for_a_store_that_refuses(
    bench: TruthRig, own_service: RunService, caplog: pytest.LogCaptureFixture
) -> None:
    run = begin(own_service, plan(sweeps=200))
    until(lambda: own_service.store.poses.count(run.id) >= 1, "a pose")
    with hindered(own_service.store, *READ_ONLY[:2]):
        until(lambda: own_service.run(run.id).status == "failed", "end of the run")
        own_service.close()
    said = [record.getMessage() for record in caplog.records if "cannot be told" in record.getMessage()]
    assert len(said) == 1, "once, not with every try"
    assert f"run {run.id} ended as failed" in said[0]
