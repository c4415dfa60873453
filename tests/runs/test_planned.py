"""What a plan is said to come to, against runs that carry it out in virtual time."""

from __future__ import annotations

import pytest
from run_rigs import CLOCK, plan, until_written

from calrig.analysis.errors import Invalid
from calrig.runs.plan_estimates import estimate, paused_s

PACE = {"velocity_dps": 20.0, "acceleration_dps2": 80.0, "homing_velocity_dps": 10.0}
SCALE = 3.0
"""Its questions take three times as much of the board's time as they do in life."""


@pytest.mark.parametrize("driver", ["smc100", "esp301"])  # one keeps its reference, the other homes each time
def test_the_duration_is_that_of_the_run_once_the_rig_has_shown_its_pace(make_rig, serve, driver):
    bench = make_rig(f"paced-{driver}", time_scale=SCALE, stage={"driver": driver, **PACE})
    service = serve(bench)

    def done(chosen):
        run = service.wait(service.start(unit="AS-1", plan=chosen).id, 300)
        assert run.status == "completed", run.error
        return run

    done(plan(elevations_deg=[5, 0, 8, -5, 6], order="given", rate_hz=20))
    for chosen in (
        plan(elevations_deg=[-10, 10, 0, 5], order="given", sweeps=2, wait_s=2.0, dwell_s=2.0, rate_hz=20),
        plan(elevations_deg=[-8, 0, 8, 2, 20, -4], order="given", velocity_dps=4.0, rate_hz=20),
        plan(elevations_deg=[10], kind="static", dwell_s=20.0, rate_hz=20),
    ):
        expected, began_s = estimate(chosen, bench.settings, service.store), CLOCK.now_s()
        run = done(chosen)
        took_s = SCALE * (CLOCK.now_s() - began_s)
        assert expected.n_poses == run.progress.poses_total
        assert took_s == pytest.approx(expected.duration_s, rel=0.05)


def test_a_stage_that_no_run_has_asked_is_taken_for_an_ordinary_one(make_rig, serve):
    bench = make_rig("new")
    expected = estimate(plan(elevations_deg=[-60, 60], sweeps=3), bench.settings, serve(bench).store)
    assert (expected.n_poses, expected.elevations_deg) == (6, [-60, 60])
    assert expected.duration_s == pytest.approx(5 + 3.25 + 3 * 6.25 + 6 * 1.65)  # trapezia at 20°/s, 80°/s²


def test_the_first_run_of_a_rig_whose_clock_is_fast_is_told_with_what_its_exchanges_take(make_rig, serve):
    """As of the simulated rig of a fresh installation: its board counts six seconds for each of theirs."""
    scale = 6.0
    bench = make_rig("fresh", time_scale=scale, stage=PACE)
    service = serve(bench)
    chosen = plan(elevations_deg=None, sweeps=4, settle_s=1.0, dwell_s=2.0, rate_hz=20)
    told = estimate(chosen, bench.settings.model_copy(update={"time_scale": scale}), service.store)
    began_s = CLOCK.now_s()
    assert service.wait(service.start(unit="AS-1", plan=chosen).id, 300).status == "completed"
    assert told.duration_s / scale == pytest.approx(CLOCK.now_s() - began_s, rel=0.1)


def test_a_pause_of_the_last_run_is_not_expected_of_the_next(make_rig, serve):
    bench = make_rig("paused", time_scale=1.0, stage=PACE)
    service = serve(bench)
    run = service.start(unit="AS-1", plan=plan(elevations_deg=None, step_deg=10, sweeps=1, rate_hz=20))
    service.pause(run.id)
    until_written(lambda: service.store.runs.get(run.id).status == "paused", "a pause")
    CLOCK.sleep(60.0)
    service.resume(run.id)
    run = service.wait(run.id, 300)
    poses = [stored.pose for stored in service.store.poses.of(run.id)]
    assert paused_s(run, poses, bench.settings) == pytest.approx(60.0, abs=3.0)


def test_a_plan_that_the_rig_would_refuse_is_refused(bench, service):
    with pytest.raises(Invalid, match=r"rig 'bench-1': elevation 120° is beyond .* limits"):
        estimate(plan(elevations_deg=[0, 120]), bench.settings, service.store)
