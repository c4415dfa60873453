"""A stage that cannot home, from one process to the next: opening its port begins its count anew."""

from __future__ import annotations

import pytest
from run_rigs import ENDLESS, begin, moving, plan, states, until

OFFSET_DEG = 0.8
ENDS_AT_DEG = 30
THERE_AND_BACK = plan(elevations_deg=[-30, 0, ENDS_AT_DEG])


@pytest.fixture
def open_loop(make_rig, request):
    """A stepper without a switch, switched on at its zero; no other test has a rig of its name."""
    return make_rig(
        request.node.name[:60],
        stage={"driver": "grbl", "homing": False},
        mechanics={"power_up_deg": 0.0},
    )


def run_again(serve, rig, unit="AS-1", **request):
    """What a later process does: it opens the port, which resets the controller wherever the table is."""
    rig.simulated.stage.reset()
    service = serve(rig)
    run = service.start(unit=unit, plan=THERE_AND_BACK, rig=rig.settings.name, **request)
    return service.wait(run.id, 60)


def test_a_second_process_knows_where_the_first_left_the_stage(open_loop, serve):
    first = run_again(serve, open_loop)
    assert first.status == "completed", first.error
    assert open_loop.table_deg(open_loop.now_s) == pytest.approx(ENDS_AT_DEG, abs=0.01)
    second = run_again(serve, open_loop)
    assert second.status == "completed", second.error
    assert second.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.1)
    assert open_loop.table_deg(open_loop.now_s) == pytest.approx(ENDS_AT_DEG, abs=0.01)


def test_a_stage_turned_by_hand_meanwhile_does_not_start_until_somebody_says_where_it_stands(
    open_loop, serve, store
):
    """Gravity tells what the store cannot know; what a person says is held against it as well."""
    assert run_again(serve, open_loop).status == "completed"
    store.positions.save(open_loop.settings.name, -25.0)
    refused = run_again(serve, open_loop)
    assert refused.status == "failed"
    assert "said to stand at -25.0°" in refused.error
    assert "gravity says 30." in refused.error
    assert "--stage-at" in refused.error
    assert open_loop.table_deg(open_loop.now_s) == pytest.approx(ENDS_AT_DEG, abs=0.01), "nothing was moved"

    assert run_again(serve, open_loop, stage_at_deg=0.0).status == "failed", "a person can be wrong"
    said = run_again(serve, open_loop, stage_at_deg=ENDS_AT_DEG)
    assert said.status == "completed", said.error
    assert said.result.bias_deg == pytest.approx(OFFSET_DEG, abs=0.1)


def test_a_process_that_died_in_mid_move_leaves_a_place_that_nobody_knows(open_loop, serve, store):
    service = serve(open_loop)
    run = begin(service, ENDLESS, rig=open_loop.settings.name)
    moving(open_loop, service, run)
    assert store.positions.of(open_loop.settings.name).stage_deg is None, "as a crash would find it"
    service.abort(run.id)
    until(lambda: states(store, run)[-1] == "aborted", "end")
    stood_deg = store.positions.of(open_loop.settings.name).stage_deg
    assert stood_deg == pytest.approx(open_loop.table_deg(open_loop.now_s), abs=0.02), "a stop is no crash"

    store.positions.save(open_loop.settings.name, None)
    refused = run_again(serve, open_loop)
    assert refused.status == "failed"
    assert "where it stands is not known; nothing was moved" in refused.error
    assert open_loop.table_deg(open_loop.now_s) == pytest.approx(stood_deg, abs=0.02)


def test_an_interrupted_run_stays_one_where_the_stage_is_not_where_it_was_left(open_loop, serve, store):
    open_loop.simulated.stage.reset()  # it greets whoever opens its port
    service = serve(open_loop)
    run = begin(service, ENDLESS, rig=open_loop.settings.name)
    until(lambda: store.poses.count(run.id), "pose", 60)
    service.close()
    assert store.runs.get(run.id).status == "interrupted"
    name, left_deg = open_loop.settings.name, store.positions.of(open_loop.settings.name).stage_deg
    for wrong_deg, why in ((left_deg + 60.0, "gravity says"), (None, "where it stands is not known")):
        open_loop.simulated.stage.reset()
        store.positions.save(name, wrong_deg)
        later = serve(open_loop)
        later.resume(run.id)
        until(lambda: store.runs.get(run.id).status == "interrupted", "end", 30)
        assert why in store.runs.get(run.id).error
        later.close()


def test_steps_lost_leave_a_place_that_nobody_knows(make_rig, serve, store):
    rig = make_rig(
        "stepper-blocked",
        stage={"driver": "grbl", "homing": False},
        mechanics={"power_up_deg": 0.0, "obstruction_deg": 20.0},
    )
    service = serve(rig)
    chosen = plan(elevations_deg=[-10, 0, 10, 0, -10, 0, 10, 30], order="given")
    lost = service.wait(service.start(unit="AS-1", plan=chosen, rig="stepper-blocked").id, 60)
    assert lost.status == "failed"
    assert "the unit felt" in lost.error
    assert store.positions.of("stepper-blocked").stage_deg is None


def test_a_stage_that_nobody_has_turned_to_its_zero_does_not_start(make_rig, serve):
    """Nothing is remembered of it, and its count begins at 0° where the table is at 25°."""
    stage = {"driver": "grbl", "homing": False}
    rig = make_rig("stepper-askew", stage=stage, mechanics={"power_up_deg": 25.0})
    refused = run_again(serve, rig, unit="AS-NEW")
    assert refused.status == "failed"
    assert "said to stand at 0.0°, where the unit should read 0.0°, and gravity says 25.8°" in refused.error
    assert not rig.has_moved()
    assert run_again(serve, rig, unit="AS-NEW", stage_at_deg=25.0).status == "completed"


def test_a_stage_that_homes_is_not_remembered(bench, service, store):
    run = service.start(unit="AS-1", plan=THERE_AND_BACK)
    assert service.wait(run.id, 60).status == "completed"
    assert store.positions.of(bench.settings.name) is None
