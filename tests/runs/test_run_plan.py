"""A run does what its plan says, against a rig whose truth is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from measured_runs import measure, measure_one
from run_rigs import TruthRig, plan

from calrig.runs.service import RunService
from calrig.store import Store


def test_a_dwell_begins_when_the_table_has_stood_for_the_time_to_settle(store: Store) -> None:
    one = measure_one(store, plan(elevations_deg=[20], settle_s=8.0))
    samples = one.store.samples.of(one.run.id)
    turned_last_s = samples.time_s[np.abs(samples.gyro_dps[:, 0]) > 5.0][-1]
    assert one.store.samples.of(one.run.id, 0).time_s[0] > turned_last_s + 8.0
    assert one.column("settle_s").tolist() == [8.0]


def test_a_dwell_ends_as_soon_as_its_reading_is_good_enough(store: Store) -> None:
    enough_deg = 0.02
    one = measure_one(store, plan(dwell_s=20.0, target_std_deg=enough_deg))
    assert (one.column("reading_stderr_deg") <= enough_deg).all()
    assert (one.column("n_samples") < 0.5 * 20.0 * 200).all()


def test_a_dwell_that_never_gets_good_enough_ends_at_its_cap(store: Store) -> None:
    one = measure_one(store, plan(dwell_s=1.5, target_std_deg=1e-4))
    np.testing.assert_allclose(one.column("n_samples"), 300, atol=1)


@pytest.mark.parametrize("order", ["random", "given"])
def test_poses_come_in_the_planned_order(store: Store, order: str) -> None:
    chosen = plan(elevations_deg=[10, -20, 30], sweeps=2, order=order, jitter_deg=3.0, seed=5)
    one = measure_one(store, chosen)
    planned = [pose.target_deg for pose in chosen.poses((-90.0, 90.0))]
    assert one.column("target_deg").tolist() == planned
    np.testing.assert_allclose(one.column("stage_deg"), planned, atol=1e-4)


def test_each_sweep_waits_before_it_begins(store: Store) -> None:
    plans = [plan(elevations_deg=[0], sweeps=3, wait_s=wait_s) for wait_s in (0.0, 8.0)]
    both = measure(store, *plans, rigs=[TruthRig("bench-1"), TruthRig("bench-2")])
    straight, waiting = (one.column("time_s") for one in both)
    assert np.diff(waiting).min() > 8.0
    assert waiting[0] > 8.0
    assert np.diff(straight).max() < 8.0


def test_a_sweep_waits_until_the_die_is_warm(store: Store) -> None:
    one = measure_one(
        store,
        plan(wait_temperature_c=30.0),
        environment={"start_c": 22.0, "end_c": 42.0, "warm_up_s": 30.0},
    )
    assert one.column("temperature_c").min() >= 30.0
    assert one.run.result.temperature_c.min == pytest.approx(one.column("temperature_c").min())


def test_moves_are_no_faster_than_planned_and_the_stage_keeps_its_own_velocity(
    make_rig: Callable[..., TruthRig], serve: Callable[..., RunService]
) -> None:
    bench = make_rig()
    service = serve(bench)
    first = service.wait(service.start(unit="AS-1", plan=plan(elevations_deg=[0])).id, 30)
    assert first.status == "completed", first.error
    homed_s = bench.now_s
    top_dps = np.abs(bench.table_dps(0.0, homed_s)).max()
    assert top_dps == pytest.approx(30.0, abs=0.01)  # while homing, at the stage's own homing velocity
    started = service.start(unit="AS-1", plan=plan(velocity_dps=25.0))
    assert service.wait(started.id, 30).status == "completed"
    assert np.abs(bench.table_dps(homed_s, bench.now_s)).max() == pytest.approx(25.0, abs=0.01)
    before_s = bench.now_s
    assert service.wait(service.start(unit="AS-1", plan=plan()).id, 30).status == "completed"
    assert np.abs(bench.table_dps(before_s, bench.now_s)).max() == pytest.approx(60.0, abs=0.01)


def test_the_board_samples_at_the_rate_asked_for(store: Store) -> None:
    one = measure_one(store, plan(rate_hz=50))
    np.testing.assert_allclose(one.column("n_samples"), 50, atol=1)
    np.testing.assert_allclose(np.diff(store.samples.of(one.run.id, 0).time_s), 0.02, rtol=1e-9)
