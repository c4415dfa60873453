"""The unit watches the stage: steps that an open loop loses are felt, and told while the run goes on."""

from __future__ import annotations

import re

import pytest
from run_rigs import events, plan

LEARNING = [-20, -10, 0, 10, 20, 10, 0, -10, -20, -10, 0, 10, 20]
THEN = [30, 20, 10, 0]
WITHIN_DEG = 0.15


def lossy(make_rig, lost_deg, **options):
    """An open-loop stage that meets an obstacle so far short of 30°, once, and knows nothing of it."""
    mechanics = {"obstruction_deg": 30.0 - lost_deg, "backlash_deg": 0.1}
    unit = {"gyro_scale_error_pct": [2.5, 0.0, 0.0], "accel_bias_mg": [0.0, 35.0, -60.0]}
    return make_rig(stage={"driver": "grbl"}, mechanics=mechanics, imu=unit, **options)


@pytest.fixture
def ended(make_rig, serve):
    """Runs the plan that learns on twelve moves and then meets the obstacle; the run as it ended."""

    def run(lost_deg, **options):
        service = serve(lossy(make_rig, lost_deg, **options))
        chosen = plan(elevations_deg=LEARNING + THEN, order="given")
        return service.wait(service.start(unit="AS-1", plan=chosen).id, 120)

    return run


def test_five_degrees_lost_end_the_run_which_says_what_was_felt_and_what_to_do(ended, store):
    run = ended(5.0)
    assert run.status == "failed"
    assert run.error.startswith(
        "pose 13 at 30°: the stage says that it turned by +10.00°, and the unit felt +"
    )
    assert "lost steps" in run.error
    assert "home the stage" in run.error
    assert run.faults["move_mismatch"] == 1
    (told,) = events(store, run, "move_mismatch")
    assert told.data["index"] == 13
    assert told.data["stage_move_deg"] == pytest.approx(10.0, abs=0.01)
    assert told.data["difference_deg"] == pytest.approx(-5.0, abs=WITHIN_DEG)
    assert told.data["ends_run"]
    assert len(store.poses.of(run.id)) == 14, "the pose that told of it is kept"


def test_one_degree_lost_is_said_live_counted_and_in_the_verdict(ended, store):
    run = ended(1.0)
    assert run.status == "completed", run.error
    assert run.faults["move_mismatch"] == 1
    (told,) = events(store, run, "move_mismatch")
    assert told.data["difference_deg"] == pytest.approx(-1.0, abs=WITHIN_DEG)
    assert abs(told.data["difference_deg"]) > 6 * told.data["std_deg"]
    assert not told.data["ends_run"]
    assert re.search("Not to be relied on: in 1 move .* steps were lost", run.verdict.says[0])
    assert run.result.gyro.scale == pytest.approx(1 / 1.025, abs=4e-3), "a lost move teaches no scale"


def test_a_slow_board_with_a_sketch_of_somebody_elses_tells_as_well(ended, store):
    run = ended(8.0, board={"sketch": "i2cdev-raw"}, time_scale=1.0)
    assert run.status == "failed", run.faults
    assert run.error.startswith("pose 13 at 30°: the stage says")


def test_a_healthy_rig_is_accused_of_nothing(make_rig, serve):
    service = serve(make_rig(stage={"driver": "grbl"}, mechanics={"backlash_deg": 0.5}))
    chosen = plan(elevations_deg=LEARNING + THEN, order="given")
    run = service.wait(service.start(unit="AS-1", plan=chosen).id, 120)
    assert (run.status, run.error) == ("completed", None)
    assert "move_mismatch" not in run.faults
