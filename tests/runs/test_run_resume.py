"""A run that was interrupted goes on where it was, on the same rig, and says that it was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rigs import CLOCK, TruthRig, begin, pass_time, plan, states, until_written

from calrig.analysis.errors import Conflict
from calrig.instruments.drivers import open_stage
from calrig.runs.run_queue import mark_interrupted, stop_stages
from calrig.runs.service import RunService
from calrig.store import Run, Store

PLAN = plan(elevations_deg=[-40, -20, 0, 20, 40], sweeps=2)

Serve = Callable[..., RunService]


def interrupted(service: RunService, store: Store, run: Run, poses: int = 3) -> Run:
    """The run after it measured some poses and its service was told to stop."""
    until_written(lambda: store.poses.count(run.id) >= poses, f"{poses} poses")
    service.close()
    left = service.run(run.id)
    assert left.status == "interrupted"
    return left


def test_an_interrupted_run_is_resumed_and_says_so(bench: TruthRig, serve: Serve, store: Store) -> None:
    first = serve(bench)
    left = interrupted(first, store, begin(first, PLAN))
    kept = store.poses.of(left.id)
    again = serve(bench)
    assert again.resume(left.id).status in {"queued", "running"}
    ended = again.wait(left.id, 30)
    assert (ended.status, ended.error) == ("completed", None)
    assert ended.finished_at is not None and ended.started_at == left.started_at
    assert ended.faults["interrupted"] == 1
    (told,) = ended.provenance["interruptions"]
    assert told["after_poses"] == len(kept) and "stopped" in told["reason"] and "resumed_at" in told
    again_deg = told["measured_again"]
    assert abs(again_deg["difference_deg"]) < 0.1
    assert again_deg["after_deg"] - again_deg["before_deg"] == pytest.approx(again_deg["difference_deg"])
    poses = store.poses.of(left.id)
    assert poses[: len(kept)] == kept
    assert [stored.pose.target_deg for stored in poses] == [p.target_deg for p in PLAN.poses((-90, 90))]
    times_s = [stored.pose.time_s for stored in poses]
    assert times_s == sorted(times_s)
    assert (np.diff(store.samples.of(left.id).time_s) > 0).all()
    assert states(store, left) == ["queued", "running", "interrupted", "queued", "running", "completed"]
    assert bench.stands_for_good()


def test_the_result_is_that_of_a_run_that_nobody_disturbed(
    make_rig: Callable[..., TruthRig], serve: Serve, store: Store
) -> None:
    play = {"mechanics": {"backlash_deg": 0.2}}
    disturbed, calm = make_rig("disturbed", **play), make_rig("calm", seed=9, **play)
    service = serve(disturbed, calm)
    undisturbed = service.wait(begin(service, PLAN, rig="calm").id, 30)
    left = interrupted(service, store, begin(service, PLAN, rig="disturbed"), 4)
    again = serve(disturbed)
    again.resume(left.id)
    resumed = again.wait(left.id, 30)
    assert resumed.status == "completed", resumed.error
    for name, std in (("bias_deg", "bias_std_deg"), ("scale", "scale_std")):
        allowed = 4 * float(np.hypot(getattr(resumed.result, std), getattr(undisturbed.result, std)))
        assert abs(getattr(resumed.result, name) - getattr(undisturbed.result, name)) < allowed, name
    approaches = [[p.pose.approach for p in store.poses.of(run.id)] for run in (resumed, undisturbed)]
    assert approaches[0] == approaches[1]
    assert resumed.result.gyro.scale == pytest.approx(undisturbed.result.gyro.scale, abs=0.01)


def test_the_time_left_of_a_resumed_run_is_what_its_other_poses_then_take(
    bench: TruthRig, serve: Serve, store: Store
) -> None:
    first = serve(bench)
    left = interrupted(first, store, begin(first, PLAN.model_copy(update={"sweeps": 1})), 2)
    again = serve(bench)
    again.resume(left.id)
    until_written(lambda: store.poses.count(left.id) > left.progress.poses_done, "a pose of its own")
    told_s, began_s = store.runs.get(left.id).progress.remaining_s, CLOCK.now_s()
    assert again.wait(left.id, 30).status == "completed"
    assert told_s == pytest.approx(CLOCK.now_s() - began_s, rel=0.3)


def test_a_stage_that_lost_its_reference_is_homed_again(
    make_rig: Callable[..., TruthRig], serve: Serve, store: Store
) -> None:
    rig, switched_on_anew = make_rig("bench"), make_rig("bench", seed=4, mechanics={"power_up_deg": -7.0})
    first = serve(rig)
    left = interrupted(first, store, begin(first, PLAN))
    again = serve(switched_on_anew)
    again.resume(left.id)
    ended = again.wait(left.id, 30)
    assert ended.status == "completed", ended.error
    assert ended.result.bias_deg == pytest.approx(0.8, abs=0.05)


def test_a_static_log_goes_on_after_a_gap(bench: TruthRig, serve: Serve, store: Store) -> None:
    first = serve(bench)
    run = begin(first, plan(kind="static", elevations_deg=[10], dwell_s=45.0))
    pass_time(bench, 20.0)
    assert len(store.samples.of(run.id).time_s) > 1000
    first.close()
    before = len(store.samples.of(run.id).time_s)
    assert first.run(run.id).status == "interrupted"
    again = serve(bench)
    again.resume(run.id)
    ended = again.wait(run.id, 30)
    assert ended.status == "completed", ended.error
    time_s = store.samples.of(run.id).time_s
    assert len(time_s) == pytest.approx(45 * 200, rel=0.01) and len(time_s) > before
    assert (np.diff(time_s) > 0).all()


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"limits_deg": (-45.0, 45.0)}, "limits_deg was"),
        ({"stage": {"zero_deg": 2.0}}, "stage.zero_deg was 0.0 and is 2.0"),
        ({"stage": {"sign": -1}}, "stage.sign was 1"),
    ],
)
def test_a_rig_that_was_configured_otherwise_is_not_resumed(
    bench: TruthRig, serve: Serve, store: Store, changed: dict[str, Any], named: str
) -> None:
    first = serve(bench)
    left = interrupted(first, store, begin(first, PLAN))
    stage = bench.settings.stage.model_copy(update=changed.pop("stage", {}))
    bench.settings = bench.settings.model_copy(update={**changed, "stage": stage})
    with pytest.raises(Conflict, match=named):
        serve(bench).resume(left.id)
    assert store.runs.get(left.id) == left


@pytest.mark.parametrize(
    ("other", "named"),
    [
        ({"board": {"firmware": "calrig 9"}}, "the board is not what it was: firmware was"),
        ({"stage": {"firmware": "SMC100CC 9.9"}}, "the stage is not what it was: firmware was"),
        ({"imu": {"accel_range_g": 8}}, "accel_range_g was 2 and is 8"),
        ({"board": {"serial": "AS-7"}}, "AS-7"),
    ],
)
def test_another_device_leaves_the_run_interrupted_and_moves_nothing(
    make_rig: Callable[..., TruthRig], serve: Serve, store: Store, other: dict[str, Any], named: str
) -> None:
    first = serve(make_rig("bench"))
    left = interrupted(first, store, begin(first, PLAN))
    exchanged = make_rig("bench", **other)
    again = serve(exchanged)
    again.resume(left.id)
    ended = again.wait(left.id, 20)
    assert ended.status == "interrupted" and named in ended.error and "nothing was moved" in ended.error
    assert not exchanged.has_moved()
    assert "interruptions" not in ended.provenance
    assert store.poses.of(left.id) and ended.finished_at is None


def test_a_unit_that_was_turned_meanwhile_is_noticed(
    make_rig: Callable[..., TruthRig], serve: Serve, store: Store
) -> None:
    first = serve(make_rig("bench"))
    left = interrupted(first, store, begin(first, PLAN))
    again = serve(make_rig("bench", mount={"offset_deg": 2.0}))
    again.resume(left.id)
    ended = again.wait(left.id, 30)
    assert ended.status == "interrupted"
    assert "changed by +1." in ended.error and "start a new run" in ended.error
    assert len(store.poses.of(left.id)) == left.progress.poses_done


def test_an_interrupted_run_can_be_aborted_instead(bench: TruthRig, serve: Serve, store: Store) -> None:
    first = serve(bench)
    left = interrupted(first, store, begin(first, PLAN))
    again = serve(bench)
    assert again.abort(left.id).status == "aborted"
    with pytest.raises(Conflict, match="is aborted"):
        again.resume(left.id)


def test_the_stage_is_told_to_stop_before_anything_else(
    bench: TruthRig, serve: Serve, store: Store, tmp_path: Path
) -> None:
    path = tmp_path / "left.db"
    with Store.open(f"sqlite:///{path}", writer="serve") as left:  # as a program leaves it that dies
        run_id = left.runs.create(unit="A", rig="bench-1", plan={}, status="running", provenance={}).id
        left.runs.create(unit="B", rig="bench-2", plan={}, status="completed", provenance={})
    stage = open_stage("smc100", bench.settings.stage.port)
    while stage.status().state in ("not_referenced", "homing"):
        if stage.status().state == "not_referenced":
            stage.home()
    stage.set_velocity(1.0)
    stage.move(-80.0)
    stage.close()
    assert bench.moves()
    before = path.read_bytes()

    def stop(names: Sequence[str]) -> None:
        assert names == ["bench-1"]
        with CLOCK.standing_aside():  # each stage is told by a thread of its own
            assert stop_stages(names, {"bench-1": bench.settings}) == {}
        assert bench.stands_for_good()
        assert path.read_bytes() == before

    with Store.open(f"sqlite:///{path}", writer="serve", left_by_the_dead=stop) as again:
        assert mark_interrupted(again, {}) == [run_id]
        assert [run.status for run in again.runs.page()[0]] == ["completed", "interrupted"]


def test_a_stage_that_cannot_be_told_is_said_with_the_run(bench: TruthRig, store: Store) -> None:
    run = store.runs.create(unit="A", rig="gone", plan={}, status="running", provenance={})
    port = bench.settings.stage.model_copy(update={"port": "/dev/nowhere"})
    gone = bench.settings.model_copy(update={"name": "gone", "stage": port})
    troubles = stop_stages(["gone", "unknown"], {"gone": gone})
    assert "not configured any more" in troubles["unknown"]
    mark_interrupted(store, troubles)
    told = store.runs.get(run.id)
    assert told.status == "interrupted"
    assert "/dev/nowhere does not exist" in told.error and "cut its motor power" in told.error
