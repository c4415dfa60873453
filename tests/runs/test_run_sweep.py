"""A sweep on a rig: what it reads without stopping is what the table did, or it says why it cannot."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from run_rigs import CLOCK, TruthRig, begin, events, states, until, until_stored

from calrig.analysis.errors import Invalid
from calrig.plan import Plan
from calrig.runs.plan_estimates import estimate
from calrig.runs.service import RunService
from calrig.store import Run, Store

SWEEP = Plan(kind="sweep", start_deg=-30, stop_deg=30, step_deg=5, sweeps=2, dwell_s=1.0, settle_s=0.7)
QUIET: dict[str, Any] = {"accel_noise_ug_per_rthz": 4.0, "gyro_noise_dps_per_rthz": 0.0005}
"""A hundredth and a tenth of the chip's noise: what is left is the method's own."""

MakeRig = Callable[..., TruthRig]
Serve = Callable[..., RunService]


def swept(rig: TruthRig, serve: Serve, chosen: Plan = SWEEP) -> Run:
    service = serve(rig)
    return service.wait(begin(service, chosen).id, 120)


def test_reports_that_are_late_and_a_gyro_that_is_wrong_leave_nothing_in_the_poses(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    rig = make_rig(
        time_scale=1.0,
        stage={"report_delay_s": 0.02},
        imu={**QUIET, "dlpf_cfg": 4, "gyro_scale_error_pct": [2.5, 0.0, 0.0]},
    )
    service = serve(rig)
    began = begin(service, SWEEP)
    until_stored(store, began, 1)
    told_s, told_at_s = store.runs.get(began.id).progress.remaining_s, CLOCK.now_s()
    run = service.wait(began.id, 120)
    assert (run.status, run.error) == ("completed", None)
    assert told_s == pytest.approx(CLOCK.now_s() - told_at_s, rel=0.1), "left after the first dwell"
    left_s = [event.data["remaining_s"] for event in events(store, run, "progress")]
    assert left_s == sorted(left_s, reverse=True)
    poses = [stored.pose for stored in store.poses.of(run.id)]
    assert len(poses) == 1 + 2 * (12 + 1) == run.progress.poses_total
    assert [pose.settle_s for pose in poses].count(None) == 24
    # the package sits 0.8° off, and reads nothing else: whatever is more is the sweep's own
    errors = np.array([pose.reading_deg - pose.theta_deg - 0.8 for pose in poses])
    assert np.abs(errors).max() < 0.005
    up = np.array([(pose.approach or 0) > 0 and pose.settle_s is None for pose in poses])
    down = np.array([(pose.approach or 0) < 0 and pose.settle_s is None for pose in poses])
    assert abs(errors[up].mean() - errors[down].mean()) < 0.003  # 0.2° without the delay solved for
    assert all(
        pose.gyro_move_deg == pytest.approx(1.025 * turned, abs=0.004) for pose, turned in moved(poses)
    )
    for one in run.provenance["sweep"]["passes"]:
        assert one["gyro_gain"] == pytest.approx(1.025, abs=0.001)
    expected_s = estimate(SWEEP, rig.settings, store).duration_s
    assert expected_s == pytest.approx((poses[-1].time_s or 0.0) + 0.5, rel=0.15)

    assert run.result is not None and run.result.bias_deg == pytest.approx(0.8, abs=0.003)
    assert run.result.gyro.scale == pytest.approx(1 / 1.025, abs=0.001)
    (revision,) = [one for one in store.revisions.of("AS-1") if one.run_id == run.id]
    assert revision.document["bias_deg"] == run.result.bias_deg
    told = [event.data for event in store.events.after(run.id, limit=10_000) if event.type == "reading"]
    speeds_dps = [
        abs(now["stage_deg"] - before["stage_deg"]) / (now["time_s"] - before["time_s"])
        for before, now in pairwise(told)
        if abs(before["stage_deg"]) < 20 and abs(now["stage_deg"]) < 20
    ]
    assert np.percentile(speeds_dps, [10, 90]) == pytest.approx([5.0, 5.0], abs=0.3), "as it turned: evenly"


def moved(poses: list[Any]) -> list[tuple[Any, float]]:
    """Each pose but the first, and what the stage turned since the one before."""
    return [(now, now.stage_deg - before.stage_deg) for before, now in pairwise(poses)]


def test_a_motor_that_biases_the_accelerometer_ends_the_run_and_says_by_how_much(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    rig = make_rig(mechanics={"vibration_g": 0.3, "motor_step_deg": 0.0187})
    run = swept(rig, serve)
    assert run.status == "failed" and run.result is None
    assert run.error is not None and "the motor biases the accelerometer while it turns at 5°/s" in run.error
    assert "take a plan of dwells" in run.error
    ends = run.provenance["sweep"]["turning_less_standing"]
    assert min(end["p_value"] for end in ends) < 0.01
    assert store.poses.of(run.id)


def test_a_sweep_that_was_interrupted_goes_on_with_the_next_pass(
    bench: TruthRig, serve: Serve, store: Store
) -> None:
    first = serve(bench)
    run = begin(first, SWEEP.model_copy(update={"start_deg": 30.0, "stop_deg": -30.0}))  # from above
    until_stored(store, run, 14)
    first.close()
    kept = [stored.pose for stored in store.poses.of(run.id)]
    assert first.run(run.id).status == "interrupted"
    again = serve(bench)
    again.resume(run.id)
    ended = again.wait(run.id, 120)
    assert (ended.status, ended.error) == ("completed", None)
    poses = [stored.pose for stored in store.poses.of(run.id)]
    assert len(poses) == 27 and poses[: len(kept)] == kept
    assert [pose.sweep for pose in poses] == 14 * [0] + 13 * [1]
    assert ended.result is not None and ended.result.n_poses == 27


def test_a_pass_in_which_the_board_was_reset_is_turned_anew(
    make_rig: MakeRig, serve: Serve, store: Store
) -> None:
    rig = make_rig(time_scale=5.0, imu=QUIET)
    service = serve(rig)
    run = begin(service, SWEEP)
    until_stored(store, run, 1)
    until(rig.moves, "the first pass", 60)
    until(lambda: rig.table_deg(rig.now_s) > 0, "its middle", 60)
    assert store.poses.count(run.id) == 1
    rig.simulated.board.reset()
    ended = service.wait(run.id, 120)
    assert (ended.status, ended.error) == ("completed", None)
    assert (ended.faults["board_reset"], ended.faults["retried_pose"]) == (1, 1)
    errors = [stored.pose.reading_deg - stored.pose.theta_deg - 0.8 for stored in store.poses.of(run.id)]
    assert np.abs(errors).max() < 0.02


def test_a_sweep_ends_after_the_pass_that_is_good_enough_and_pauses_between_passes(
    bench: TruthRig, serve: Serve, store: Store
) -> None:
    service = serve(bench)
    chosen = SWEEP.model_copy(update={"sweeps": 6, "until": Plan(until={"bias_std_deg": 0.004}).until})
    run = begin(service, Plan.model_validate(chosen.model_dump()))
    until_stored(store, run, 1)
    service.pause(run.id)
    until(lambda: service.run(run.id).status == "paused", "pause", 60)
    assert len(store.poses.of(run.id)) in (1, 14)
    service.resume(run.id)
    ended = service.wait(run.id, 120)
    assert ended.status == "completed" and ended.result is not None
    assert ended.result.stopped_by == "until" and ended.result.bias_std_deg <= 0.004
    assert len(store.poses.of(run.id)) in (27, 40)
    assert states(store, run).count("paused") == 1


def test_a_stage_that_hardly_comes_up_to_the_velocity_is_refused(make_rig: MakeRig, serve: Serve) -> None:
    run = swept(make_rig(stage={"acceleration_dps2": 2.0}), serve)
    assert run.status == "failed"
    assert "comes up to 5°/s and slows down within the stretch" in (run.error or "")


def test_a_sweep_beyond_the_limits_is_refused_by_the_name_of_its_ends(bench: TruthRig, serve: Serve) -> None:
    with pytest.raises(Invalid, match="beyond the rig's soft limits") as refused:
        begin(serve(bench), Plan(kind="sweep", start_deg=-100, stop_deg=30))
    assert refused.value.fields == ["plan.start_deg"]


SHORT_SWEEP = SWEEP.model_copy(update={"start_deg": -15.0, "stop_deg": 15.0})


def stall(rig: TruthRig, monkeypatch: pytest.MonkeyPatch, every_s: float = math.inf) -> None:
    """Has the rig's own time stand for 0.25 s, now and every so often: table and devices, not the host."""
    clock, began_s = rig.simulated.clock, CLOCK.now_s()
    before = clock._now_s

    def now_s() -> float:
        times, since_s = divmod(rig.time_scale * (CLOCK.now_s() - began_s), every_s)
        return before() - 0.25 * times - min(since_s, 0.25)

    monkeypatch.setattr(clock, "_now_s", now_s)


def in_the_midst_of_a_pass(rig: TruthRig, store: Store, run: Run, n_poses: int) -> None:
    """Until so many poses are stored and the table is about half-way to the other end."""
    until_stored(store, run, n_poses, 120)
    until(rig.moves, "pass", 60)
    until(lambda: abs(rig.table_deg(rig.now_s)) < 3, "its middle", 60)


def test_a_pass_in_which_the_rig_stood_for_a_moment_is_turned_anew(
    make_rig: MakeRig, serve: Serve, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig(time_scale=5.0, imu=QUIET)
    service = serve(rig)
    run = begin(service, SHORT_SWEEP)
    in_the_midst_of_a_pass(rig, store, run, 8)
    stall(rig, monkeypatch)
    ended = service.wait(run.id, 300)
    assert (ended.status, ended.error) == ("completed", None)
    assert ended.faults["retried_pose"] == 1
    poses = [stored.pose for stored in store.poses.of(run.id)]
    assert len(poses) == 15
    assert np.abs([pose.reading_deg - pose.theta_deg - 0.8 for pose in poses]).max() < 0.02
    assert ended.result is not None and ended.result.lost_says is None


@pytest.mark.parametrize("good", [1, 2])
def test_passes_that_are_never_even_end_the_run_with_those_before_if_both_senses_are_there(
    make_rig: MakeRig, serve: Serve, store: Store, monkeypatch: pytest.MonkeyPatch, good: int
) -> None:
    rig = make_rig(time_scale=5.0, imu=QUIET)
    service = serve(rig)
    run = begin(service, SHORT_SWEEP.model_copy(update={"sweeps": 3}))
    n_whole = 1 + 7 * good
    in_the_midst_of_a_pass(rig, store, run, n_whole)
    stall(rig, monkeypatch, every_s=4.0)
    ended = service.wait(run.id, 300)
    assert ended.faults["retried_pose"] >= 3
    assert len(store.poses.of(run.id)) == n_whole
    if good == 1:
        assert ended.status == "failed"
        assert "3 times over" in (ended.error or "") and "does not turn evenly" in (ended.error or "")
        return
    assert (ended.status, ended.error) == ("completed", None)
    done = ended.progress
    assert (done.poses_done, done.poses_total, done.fraction) == (n_whole, n_whole, 1.0)
    assert ended.result is not None and ended.result.bias_deg == pytest.approx(0.8, abs=0.01)
    assert ended.verdict is not None
    (said,) = [one for one in ended.verdict.says if "after 2 of 3 passes" in one]
    assert "from -15° to 15°, 3 times over" in said and "does not turn evenly" in said
    assert ended.result.lost_says == said
