"""The red button tells the truth: told whatever the run waits for, and 200 only for a stage that stands."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from empty_store import lay_empty_store
from postgresql_server import store_at
from run_rigs import CLOCK, ENDLESS, TruthRig, begin, moving, pass_time, plan, until
from support import fast, known_as, wait_for

from calrig.analysis.errors import Conflict
from calrig.instruments.clock import Event
from calrig.instruments.drivers import open_stage
from calrig.instruments.types import Stage
from calrig.runs.service import RunService
from calrig.simulator.rig import SimulatedRig
from calrig.store import Store

ANSWERED_S = 6.0
"""Within which a stop is answered that cannot be seen to be heeded, s of the rig's clock."""
MakeRig = Callable[..., TruthRig]
Serve = Callable[..., RunService]


@pytest.mark.parametrize(
    ("driver", "fault"),
    [("smc100", "garbage"), ("grbl", "garbage"), ("esp301", "hang"), ("grbl", "hang")],
)
def test_a_stop_ends_the_identification_of_a_stage_and_says_it_is_not_known_to_stand(
    make_rig: MakeRig, serve: Serve, driver: str, fault: str
) -> None:
    """A garbled ESP301 is told apart at once; one that is mute takes longest."""
    bench = make_rig(stage={"driver": driver, "fault": fault})
    service = serve(bench)
    run = begin(service)
    until(lambda: service.run(run.id).status == "running", "begin")
    pass_time(bench, 2)
    asked_s = CLOCK.now_s()
    with pytest.raises(Conflict, match=r"bench-1.*not known to stand.*cut its motor power"):
        service.stop("bench-1")
    assert CLOCK.now_s() - asked_s < ANSWERED_S
    ended = service.wait(run.id, 3)
    assert ended.status == "aborted"
    assert "the stage was stopped by request; " in (ended.error or "")
    assert "cut its motor power" in (ended.error or "")


def test_a_stop_while_a_silent_board_is_waited_for_is_answered_by_a_stage_that_stands(
    make_rig: MakeRig, serve: Serve
) -> None:
    bench = make_rig(board={"fault": "silent"})
    service = serve(bench)
    run = begin(service)
    until(lambda: service.run(run.id).status == "running", "begin")
    asked_s = CLOCK.now_s()
    service.stop("bench-1")
    assert CLOCK.now_s() - asked_s < 1.0
    assert service.wait(run.id, 2).status == "aborted"
    assert service.rigs()[0].state == "idle"


def test_all_who_press_while_a_stage_is_being_told_share_that_and_no_other_rig_waits(
    make_rig: MakeRig, serve: Serve
) -> None:
    mute = make_rig("mute", stage={"driver": "grbl", "fault": "hang"})
    other = make_rig("other")
    service = serve(mute, other)
    run = begin(service, rig="other")
    moving(other, service, run)
    pressed = {service.begin_stop("mute") for _ in range(60)}
    assert len(pressed) == 1
    asked_s = CLOCK.now_s()
    service.stop("other")
    assert CLOCK.now_s() - asked_s < 0.5
    assert other.stands_for_good()
    (errand,) = pressed
    assert not errand.future.done()
    with pytest.raises(Conflict, match=r"mute.*cut its motor power"):
        errand.result()
    assert service.begin_stop("mute") is not errand


def test_a_stop_is_made_and_answered_though_the_store_is_locked(bench: TruthRig, tmp_path: Path) -> None:
    path = tmp_path / "calrig.db"
    lay_empty_store(path)
    with (
        Store.open(store_at(path), writer="tests", busy_timeout_s=0.1) as store,
        closing(RunService(store, [bench.settings])) as service,
    ):
        run = begin(service, ENDLESS)
        moving(bench, service, run)
        service.start(unit="AS-2", plan=ENDLESS, queue=True)
        with closing(sqlite3.connect(path, isolation_level=None)) as somebody:
            somebody.execute("BEGIN IMMEDIATE")
            assert service.abort(run.id).status == "aborted"
            assert bench.stands_for_good()
            stopping = service.begin_stop("bench-1")
            calling_off = [one for one in threading.enumerate() if one.name == "call-off at bench-1"]
            assert all(one.daemon for one in calling_off), "who waits for the store keeps no process"
            assert stopping.result().state == "idle"
            somebody.execute("ROLLBACK")
        assert service.wait(run.id, 10).status == "aborted"


def test_a_run_whose_pose_waits_for_a_locked_store_hears_a_stop_at_once(tmp_path: Path) -> None:
    """By the wall's clock, as SQLite waits: 30 s for another program's lock, which the stop does not have."""
    path = tmp_path / "calrig.db"
    lay_empty_store(path)
    with (
        SimulatedRig(fast({})) as bench,
        Store.open(store_at(path), writer="tests", busy_timeout_s=30.0) as store,
        closing(RunService(store, [known_as("bench-1", bench)])) as service,
        closing(sqlite3.connect(path, isolation_level=None)) as somebody,
    ):
        run = begin(service, ENDLESS)
        wait_for(lambda: store.poses.count(run.id) >= 1, "pose")
        somebody.execute("BEGIN IMMEDIATE")
        wait_for(store._database._writes.locked, "write that waits")
        assert service.abort(run.id).status == "aborted"
        assert store.runs.get(run.id).status == "running", "it cannot be told yet"
        somebody.execute("ROLLBACK")
        assert service.wait(run.id, 20).status == "aborted"


def test_a_stop_of_a_rig_whose_run_has_just_ended_is_told_to_the_stage_itself(
    bench: TruthRig, service: RunService
) -> None:
    service.wait(begin(service, plan(elevations_deg=[0], dwell_s=0.5)).id, 20)
    assert service.stop("bench-1").state == "idle"
    assert bench.stands_for_good()


@pytest.fixture
def opens(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Event]]:
    """Each opening of a stage's port, held up until it is set: as by a driver that hangs in the system."""
    held: list[Event] = []

    def late(*args: Any, **options: Any) -> Stage:
        held.append(CLOCK.event())
        held[-1].wait(60)
        return open_stage(*args, **options)

    monkeypatch.setattr("calrig.runs.rig.open_stage", late)
    yield held
    for one in held:
        one.set()


def test_a_port_that_does_not_open_is_told_of_soon_and_waited_for_once(
    bench: TruthRig, service: RunService, opens: list[Event]
) -> None:
    for _ in range(3):
        asked_s = CLOCK.now_s()
        with pytest.raises(Conflict, match=r"bench-1.*within 2 s.*cut"):
            service.stop("bench-1")
        assert CLOCK.now_s() - asked_s < 2.1
    assert len(opens) == 1
    opens[0].set()
    assert service.stop("bench-1").state == "idle"
    assert bench.stands_for_good()


def test_a_run_whose_port_does_not_open_says_so_when_it_is_stopped_and_stops_its_stage_when_it_does(
    bench: TruthRig, service: RunService, opens: list[Event]
) -> None:
    run = begin(service)
    until(lambda: bool(opens), "opening")
    asked_s = CLOCK.now_s()
    with pytest.raises(Conflict, match=rf"to run {run.id}, .* within 2 s"):
        service.stop("bench-1")
    assert CLOCK.now_s() - asked_s < 2.1
    opens[0].set()
    assert service.wait(run.id, 5).status == "aborted"
    assert bench.stands_for_good()
