"""The event log: stored before anybody hears of it, without gaps, and true to what the run did."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from run_rigs import CLOCK, TruthRig, events, plan, states

from calrig.model.run import AT_REST
from calrig.runs.service import RunService
from calrig.store import Event, Run, Store


@pytest.fixture(scope="module")
def logged(store: Store) -> tuple[Run, list[Event], float]:
    """A completed run, its log and the seconds it took."""
    rig = TruthRig()
    with rig.simulated:
        service = RunService(store, [rig.settings])
        began = CLOCK.now_s()
        run = service.wait(service.start(unit="AS-1", plan=plan(sweeps=2, velocity_dps=20.0)).id, 30)
        took_s = CLOCK.now_s() - began
        service.close()
    assert run.status == "completed", run.error
    return run, events(store, run), took_s


def of(log: list[Event], kind: str) -> list[dict[str, Any]]:
    return [event.data for event in log if event.type == kind]


def test_events_are_numbered_without_a_gap_and_end_with_the_terminal_state(
    logged: tuple[Run, list[Event], float],
) -> None:
    _, log, _ = logged
    assert [event.seq for event in log] == list(range(1, len(log) + 1))
    assert [data["status"] for data in of(log, "state")] == ["queued", "running", "completed"]
    assert (log[0].type, log[-1].type) == ("state", "state")
    assert log[-1].data == {"status": "completed", "error": None}


def test_pose_events_are_the_stored_poses(logged: tuple[Run, list[Event], float], store: Store) -> None:
    run, log, _ = logged
    clamped = {"mount": f"{run.id} 0°", "mount_deg": 0.0, "mount_axis": "x"}
    stored = [{"index": pose.index, **pose.pose.row(), **clamped} for pose in store.poses.of(run.id)]
    told = of(log, "pose")
    errors_deg = [pose.pop("raw_error_deg") for pose in told]
    assert told == stored
    assert errors_deg == pytest.approx([pose["reading_deg"] - pose["stage_deg"] for pose in stored])
    assert len(stored) == 6


def test_progress_follows_each_pose(logged: tuple[Run, list[Event], float]) -> None:
    run, log, _ = logged
    progress = of(log, "progress")
    assert [one["poses_done"] for one in progress] == [1, 2, 3, 4, 5, 6]
    assert {one["poses_total"] for one in progress} == {6}
    assert [one["fraction"] for one in progress] == pytest.approx([k / 6 for k in range(1, 7)])
    assert progress[-1]["remaining_s"] == 0.0
    assert all(one["remaining_s"] > 0 for one in progress[:-1])
    assert run.progress.model_dump() == progress[-1]


def test_readings_are_thinned_to_twenty_a_second(logged: tuple[Run, list[Event], float]) -> None:
    _, log, took_s = logged
    readings = of(log, "reading")
    assert 5 * took_s < len(readings) <= 20 * took_s + 1
    assert all(before["time_s"] <= after["time_s"] for before, after in pairwise(readings))
    assert all(set(one) == {"time_s", "stage_deg", "reading_deg", "temperature_c"} for one in readings)
    turning = [one["stage_deg"] for one in readings if one["stage_deg"] is not None]
    assert any(-29 < angle < -1 or 1 < angle < 29 for angle in turning)  # seen on the move


def test_what_was_seen_before_a_pose_was_done_is_told_before_the_pose(
    logged: tuple[Run, list[Event], float],
) -> None:
    run, log, _ = logged
    done_s = 0.0
    for event in log:
        if event.type == "pose":
            done_s = event.data["time_s"] + run.plan["dwell_s"] / 2
        elif event.type == "reading":
            assert event.data["time_s"] >= done_s, f"event {event.seq}"
    assert done_s > 0.0


def test_what_is_announced_is_already_in_the_store(
    bench: TruthRig, service: RunService, store: Store
) -> None:
    run = service.start(unit="AS-1", plan=plan())
    heard: list[Event] = []
    missing: list[Event] = []

    def look() -> None:
        new = store.events.after(run.id, heard[-1].seq if heard else 0)
        heard.extend(new)
        kept = {pose.index for pose in store.poses.of(run.id)}
        status = store.runs.get(run.id).status
        missing.extend(e for e in new if e.type == "pose" and e.data["index"] not in kept)
        missing.extend(e for e in new if e.type == "state" and e is new[-1] and e.data["status"] != status)
        missing.extend(
            e for e in new if e.type == "pose" and not len(store.samples.of(run.id, e.data["index"]))
        )

    unsubscribe = service.bus.subscribe(run.id, look)
    service.wait(run.id, 30)
    unsubscribe()
    assert missing == []
    assert heard == events(store, run)


def test_nobody_hears_after_unsubscribing(bench: TruthRig, service: RunService, store: Store) -> None:
    run = service.start(unit="AS-1", plan=plan(elevations_deg=[0]))
    calls: list[int] = []
    service.bus.subscribe(run.id, lambda: calls.append(1))()
    assert service.wait(run.id, 30).status == "completed"
    assert calls == []


def test_a_run_is_told_as_it_was_asked_for(bench: TruthRig, service: RunService, store: Store) -> None:
    run = service.start(unit="AS/1 <b>", plan=plan(elevations_deg=[0]), operator="Ada", note="after lunch")
    assert (run.unit, run.rig, run.operator, run.note) == ("AS/1 <b>", "bench-1", "Ada", "after lunch")
    assert run.progress.poses_total == 1
    ended = service.wait(run.id, 30)
    assert ended.created_at <= ended.started_at <= ended.finished_at
    assert ended.status in AT_REST
    assert ended.provenance["operator"] == "Ada"
    assert states(store, run) == ["queued", "running", "completed"]
