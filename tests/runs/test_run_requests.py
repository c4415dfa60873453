"""What people ask of a run while it goes on: pause, resume, abort, each at any moment."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from run_rigs import (
    CLOCK,
    ENDLESS,
    STOPPED_S,
    TruthRig,
    begin,
    dwelling,
    events,
    homing,
    moving,
    pass_time,
    paused,
    plan,
    states,
    until,
)

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.instruments.ports import open_port
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.store import Run, Store

STILL = plan(elevations_deg=[0, 5], order="given", dwell_s=4.0, sweeps=50)
"""Hardly moves: it dwells nearly all the time."""


def test_pause_finishes_the_pose_and_holds_and_resume_goes_on(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = begin(service, plan(elevations_deg=[-40, 0, 40], sweeps=2, velocity_dps=20))
    until(bench.moves, "motion")
    service.pause(run.id)
    until(lambda: service.run(run.id).status == "paused", "pause")
    held_s, done = bench.now_s, store.poses.of(run.id)
    assert len(done) == 1
    assert bench.table_deg(held_s) == pytest.approx(done[0].pose.target_deg, abs=1e-3)
    assert service.rigs()[0].state == "busy"
    pass_time(bench, 15)
    assert bench.table_dps(held_s, bench.now_s).any() == False  # noqa: E712 (a NumPy bool)
    assert store.poses.of(run.id) == done

    service.resume(run.id)
    assert service.wait(run.id, 30).status == "completed"
    assert [stored.index for stored in store.poses.of(run.id)] == list(range(6))
    assert states(store, run) == ["queued", "running", "paused", "running", "completed"]


def test_a_pause_taken_back_in_time_never_happens(bench: TruthRig, service: RunService, store: Store) -> None:
    run = begin(service, plan(elevations_deg=[-40, 40], velocity_dps=20))
    until(bench.moves, "motion")
    service.pause(run.id)
    service.resume(run.id)
    assert service.wait(run.id, 30).status == "completed"
    assert "paused" not in states(store, run)


def test_the_account_of_a_move_after_a_pause_is_as_good_as_any(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = begin(service, plan(elevations_deg=[-40, 40]))
    paused(bench, service, run)
    pass_time(bench, 30)
    service.resume(run.id)
    assert service.wait(run.id, 30).status == "completed"
    assert [p.pose.gyro_move_deg for p in store.poses.of(run.id)] == pytest.approx([-40, 80], abs=0.1)


def test_the_time_left_is_reckoned_without_the_pause(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = begin(service, plan(elevations_deg=[-10, 10], sweeps=4))
    paused(bench, service, run)
    done = len(store.poses.of(run.id))
    pass_time(bench, 30)
    service.resume(run.id)
    assert service.wait(run.id, 30).status == "completed"
    left_s = [event.data["remaining_s"] for event in events(store, run, "progress")]
    assert left_s[done] < left_s[done - 1] + 1.0


@pytest.mark.parametrize(
    ("chosen", "reached"),
    [(ENDLESS, moving), (ENDLESS, homing), (STILL, dwelling), (plan(sweeps=50), paused)],
    ids=["moving", "homing", "dwelling", "paused"],
)
def test_abort_stops_the_stage_at_once_and_keeps_what_was_measured(
    bench: TruthRig,
    service: RunService,
    store: Store,
    chosen: Plan,
    reached: Callable[[TruthRig, RunService, Run], None],
) -> None:
    run = begin(service, chosen)
    reached(bench, service, run)
    done = store.poses.of(run.id)

    asked_s = bench.now_s
    ended = service.abort(run.id)

    assert ended.status == "aborted"
    assert bench.stood_after_s(asked_s) < STOPPED_S
    assert bench.stands_for_good()
    assert store.poses.of(run.id)[: len(done)] == done
    assert states(store, run)[-1] == "aborted"
    assert service.rigs()[0].state == "idle"
    again = service.wait(begin(service, plan(elevations_deg=[-5, 5]), unit="AS-2").id, 30)
    assert again.status == "completed", again.error


def test_abort_before_the_run_has_reached_the_rig_moves_nothing(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = begin(service)
    assert service.abort(run.id).status == "aborted"
    assert not bench.has_moved()
    assert bench.stands_for_good()
    assert store.poses.of(run.id) == []
    assert service.rigs()[0].state == "idle"


def test_a_stage_that_hears_again_is_stopped_by_the_abort_it_missed(
    bench: TruthRig, service: RunService
) -> None:
    run = begin(service, plan(elevations_deg=[-80, 80], velocity_dps=2))
    until(lambda: bench.table_deg(bench.now_s) < -10, "move", 20)
    bench.simulated.stage.fault = "hang"
    asked = CLOCK.thread(lambda: service.abort(run.id), "abort")
    asked.start()
    pass_time(bench, 6)
    assert bench.moves()
    bench.simulated.stage.fault = None
    heard_s = bench.now_s
    asked.join()
    assert service.wait(run.id, 10).status == "aborted"
    assert bench.stood_after_s(heard_s) < 2.0
    assert bench.stands_for_good()


def test_an_abort_that_a_dead_stage_cannot_hear_says_so(bench: TruthRig, service: RunService) -> None:
    run = begin(service, plan(elevations_deg=[-80, 80], velocity_dps=5))
    until(lambda: bench.table_deg(bench.now_s) < -10, "move", 20)
    bench.simulated.stage.fault = "hang"
    with pytest.raises(Conflict, match=r"bench-1.*not known to stand.*cut its motor power"):
        service.abort(run.id)
    ended = service.wait(run.id, 15)
    assert ended.status == "aborted"
    assert ended.error is not None
    assert "cut its motor power" in ended.error


def test_a_second_abort_finds_the_run_ended(bench: TruthRig, service: RunService) -> None:
    run = begin(service)
    service.abort(run.id)
    with pytest.raises(Conflict, match="aborted"):
        service.abort(run.id)


def test_a_rig_does_one_run_at_a_time(bench: TruthRig, service: RunService, store: Store) -> None:
    run = begin(service)
    with pytest.raises(Conflict, match=f"bench-1.*busy.*{run.id}"):
        begin(service, plan(), unit="AS-2")
    assert service.run(run.id).status in {"queued", "running"}
    assert store.units.get("never on a rig") is None
    service.abort(run.id)


def test_two_rigs_run_side_by_side(
    make_rig: Callable[..., TruthRig], serve: Callable[..., RunService], store: Store
) -> None:
    rigs = [make_rig("left", mount={"offset_deg": 2.0}), make_rig("right", mount={"offset_deg": -1.0})]
    service = serve(*rigs)
    runs = [begin(service, unit=f"on {name}", rig=name) for name in ("left", "right")]
    until(lambda: all(rig.moves() for rig in rigs), "both at once")
    assert [(rig.name, rig.state, rig.run_id) for rig in service.rigs()] == [
        ("left", "busy", runs[0].id),
        ("right", "busy", runs[1].id),
    ]
    for run in runs:
        service.abort(run.id)
    runs = [begin(service, plan(), unit=f"on {name}", rig=name) for name in ("left", "right")]
    bias = [service.wait(run.id, 30).result.bias_deg for run in runs]
    assert bias == pytest.approx([2.0, -1.0], abs=0.1)


@pytest.mark.parametrize("request_name", ["abort", "pause", "resume"])
def test_requests_of_a_run_that_is_not_there_or_has_ended(service: RunService, request_name: str) -> None:
    request = getattr(service, request_name)
    with pytest.raises(Unknown, match="999999"):
        request("999999")
    run = begin(service)
    service.abort(run.id)
    with pytest.raises(Conflict, match="aborted"):
        request(run.id)


def test_resume_of_a_run_that_is_not_paused(service: RunService) -> None:
    run = begin(service)
    with pytest.raises(Conflict, match="not paused"):
        service.resume(run.id)
    service.abort(run.id)


def test_an_unknown_rig_is_refused_with_those_there_are(service: RunService, store: Store) -> None:
    with pytest.raises(Unknown, match=r"bench-9.*bench-1"):
        begin(service, unit="AS-unknown-rig", rig="bench-9")
    assert store.units.get("AS-unknown-rig") is None


@pytest.mark.parametrize("elevation_deg", [-90.5, 91.0, 200.0])
def test_an_elevation_beyond_the_limits_is_refused_before_anything_moves(
    bench: TruthRig, service: RunService, store: Store, elevation_deg: float
) -> None:
    with pytest.raises(Invalid, match=rf"bench-1.*{elevation_deg:g}°.*-90° to 90°"):
        begin(service, plan(elevations_deg=[0, elevation_deg]), unit="AS-too-far")
    assert store.units.get("AS-too-far") is None
    assert not bench.has_moved()


@pytest.mark.parametrize("serial", ["", " ", "A\n", " A", "A\x00B", "x" * 101, "x" * 10_000])
def test_a_serial_number_that_cannot_be_one_is_refused(
    service: RunService, store: Store, serial: str
) -> None:
    before = store.runs.page()
    with pytest.raises(Invalid, match="serial number") as refused:
        begin(service, unit=serial)
    assert len(str(refused.value)) < 200
    assert store.runs.page() == before


def test_who_waits_for_a_run_gets_it_ended(bench: TruthRig, service: RunService) -> None:
    run = begin(service, plan(elevations_deg=[0], dwell_s=0.5))
    until(lambda: service.rigs()[0].state == "idle", "free rig")
    assert service.wait(run.id, 10).status == "completed"


def test_who_hears_of_the_end_may_start_the_next_run(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = begin(service, plan(elevations_deg=[0]))
    heard: list[Run] = []

    def look() -> None:
        if states(store, run)[-1] == "completed" and not heard:
            heard.append(service.start(unit="AS-2", plan=plan(elevations_deg=[0])))

    service.bus.subscribe(run.id, look)
    until(lambda: heard, "next run")
    assert service.wait(heard[0].id, 20).status == "completed"
    assert events(store, heard[0])


def test_a_stop_of_the_rig_stops_the_stage_at_once_and_aborts_the_run(
    bench: TruthRig, service: RunService
) -> None:
    run = begin(service)
    moving(bench, service, run)
    asked_s = bench.now_s
    assert service.stop("bench-1").name == "bench-1"
    until(bench.stands_for_good, "stop")
    assert bench.stood_after_s(asked_s) < STOPPED_S
    ended = service.wait(run.id, 10)
    assert (ended.status, ended.error) == ("aborted", "the stage was stopped by request")


def test_a_stage_that_another_program_left_moving_is_stopped_as_well(
    bench: TruthRig, service: RunService
) -> None:
    completed = service.wait(begin(service, plan(elevations_deg=[0], dwell_s=0.5)).id, 20)
    assert completed.status == "completed"
    port = open_port(bench.settings.stage.port, baudrate=57600, timeout_s=0.1)
    port.write(b"1VA4\r\n1PA70\r\n")
    port.close()
    until(bench.moves, "motion that no run commanded")
    assert service.stop("bench-1").state == "idle"
    until(bench.stands_for_good, "stop")
    assert bench.table_deg(bench.now_s) < 60


def test_a_stop_of_no_rig_is_refused(service: RunService) -> None:
    with pytest.raises(Unknown, match="bench-7"):
        service.stop("bench-7")
