"""Two runs of one unit taken together: what differs between them is traced like anything else.

The runs come of the blind board's physics: a rig and a unit of which something was changed between them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studies.blind.physics import Cause, Noise, measure

from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.conclusion import conclude
from calrig.calibration.diagnosis.report import partial_residuals
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.regression.responses import responses_of
from calrig.plan import Plan

PLAN = Plan(start_deg=-60.0, stop_deg=60.0, step_deg=7.5, sweeps=2, jitter_deg=2.0)
WHITE = Noise()
NOISE_DEG = WHITE.reading_deg
BETWEEN = {"from": "17", "to": "18"}
Options = dict[str, dict[str, object]]
AS_IT_WAS: Options = {}
TURNED: Options = {"mount": {"offset_deg": 0.95}}
"""The mount of these rigs lies at 0.8°."""
OFF_BY_80_MG: Options = {"imu": {"accel_bias_mg": [0.0, 0.0, 80.0]}}
"""So large that the angle is no straight line of it."""


def run_of(wrong: Options, seed: int, noise: Noise = WHITE) -> list[Pose]:
    rng = np.random.default_rng([seed, 12])
    plan = PLAN.model_copy(update={"seed": int(rng.integers(2**31))})
    causes = [Cause(part, "unknown", "unknown", {part: options}) for part, options in wrong.items()]
    return measure(plan, causes, noise, rng).poses


def without_accelerometer(run: list[Pose]) -> list[Pose]:
    return [replace(pose, accel_x_g=None, accel_y_g=None, accel_z_g=None) for pose in run]


def at_temperature(run: list[Pose], celsius: float) -> list[Pose]:
    """The run with a thermometer that hardly moved."""
    flicker = np.random.default_rng(int(celsius)).normal(0.0, 0.01, len(run))
    return [replace(pose, temperature_c=celsius + float(f)) for pose, f in zip(run, flicker, strict=True)]


def traced(*runs: list[Pose], cross_fit: bool = False) -> dict[str, object]:
    ids = [str(17 + k) for k in range(len(runs))]
    return document(diagnose(runs, ids, bootstraps=199, cross_fit=cross_fit), ids)


@pytest.mark.parametrize(
    ("before", "after", "name", "parameter", "true"),
    [
        (AS_IT_WAS, TURNED, "mount_change", "deg", 0.15),
        (AS_IT_WAS, {"imu": {"accel_bias_mg": [0.0, 0.0, 6.0]}}, "accelerometer_offset", "z_mg", 6.0),
        ({"imu": {"accel_gain_error_pct": [0.0, 0.5, 0.0]}}, AS_IT_WAS, "axis_mismatch", "gain_pct", -0.5),
        (AS_IT_WAS, OFF_BY_80_MG, "accelerometer_offset", "z_mg", 80.0),
        pytest.param(
            OFF_BY_80_MG, AS_IT_WAS, "accelerometer_offset", "z_mg", -80.0, marks=pytest.mark.statistical
        ),
    ],
)
def test_what_changed_between_two_runs_is_named_with_its_size(before, after, name, parameter, true):
    found = traced(run_of(before, 1), run_of(after, 2))
    (effect,) = (one for one in found["effects"] if one["changed"] is not None)
    value = effect["parameters"][parameter]
    assert (effect["name"], effect["verdict"], effect["changed"]) == (name, "named", BETWEEN)
    assert value["value"] == pytest.approx(true, abs=5.0 * value["std"])
    assert found["final"]["fit_rms_deg"] < 1.1 * NOISE_DEG < found["base"]["fit_rms_deg"]


def test_a_reading_that_moved_while_the_accelerometer_did_not_has_another_bias():
    later = [replace(pose, reading_deg=pose.reading_deg - 0.1) for pose in run_of(AS_IT_WAS, 2)]
    (effect,) = traced(run_of(AS_IT_WAS, 1), later)["effects"]
    value = effect["parameters"]["deg"]
    assert (effect["name"], effect["verdict"]) == ("bias_change", "named")
    assert value["value"] == pytest.approx(-0.1, abs=5.0 * value["std"])


def test_without_an_accelerometer_nobody_knows_whether_the_mount_or_the_bias_changed():
    runs = [without_accelerometer(run) for run in (run_of(AS_IT_WAS, 1), run_of(TURNED, 2))]
    (effect,) = traced(*runs)["effects"]
    assert {effect["name"], *effect["confusable_with"]} == {"mount_change", "bias_change"}


def test_within_60_degrees_another_scale_of_the_stage_is_as_good_as_an_eccentricity():
    """What a line leaves of sin θ there is 5.5 % of it."""
    (effect,) = traced(run_of(AS_IT_WAS, 1), run_of({"mechanics": {"scale_error_pct": 0.5}}, 2))["effects"]
    assert effect["changed"] == BETWEEN
    assert {effect["name"], *effect["confusable_with"]} == {"scale_change", "stage_eccentricity"}


def test_a_run_in_the_cold_and_one_in_the_warm_do_not_tell_the_mount_from_temperature():
    cold, warm = at_temperature(run_of(AS_IT_WAS, 1), 20.0), at_temperature(run_of(TURNED, 2), 30.0)
    (effect,) = traced(cold, warm)["effects"]
    assert {"mount_change", "temperature_bias"} <= {effect["name"], *effect["confusable_with"]}


def test_what_was_the_same_in_both_runs_is_no_change_beside_one_that_is():
    worn = {"mechanics": {"backlash_deg": 0.12}}
    found = {
        e["name"]: e["changed"] for e in traced(run_of(worn, 1), run_of({**worn, **TURNED}, 2))["effects"]
    }
    assert found == {"backlash": None, "mount_change": BETWEEN}


def test_two_runs_that_do_not_differ_say_nothing():
    assert traced(run_of(AS_IT_WAS, 1), run_of(AS_IT_WAS, 2))["verdict"] == "nothing"


def test_a_mount_that_was_turned_and_turned_back_changed_twice():
    first, second = traced(run_of(AS_IT_WAS, 1), run_of(TURNED, 2), run_of(AS_IT_WAS, 3))["effects"]
    assert [one["changed"]["to"] for one in (first, second)] == ["18", "19"]
    assert [np.sign(one["parameters"]["deg"]["value"]) for one in (first, second)] == [1.0, -1.0]


@pytest.mark.slow
def test_the_error_on_held_out_poses_falls_with_what_changed():
    found = traced(run_of(AS_IT_WAS, 1), run_of(TURNED, 2), cross_fit=True)
    assert found["base"]["held_out_rms_deg"] > 2.0 * NOISE_DEG
    assert found["final"]["held_out_rms_deg"] < 1.15 * NOISE_DEG
    answer = conclude({**found, "confirmed_by": None}).says[0]
    assert answer.endswith("changed from run 17 to run 18")


def test_a_change_is_drawn_as_a_step_between_the_runs_and_is_missed_where_one_has_no_poses():
    runs = [run_of(AS_IT_WAS, 1), run_of(TURNED, 2)]
    effects = traced(*runs)["effects"]
    (drawn,) = partial_residuals(runs, effects, ["17", "18"])
    assert drawn.covariate == "run"
    before, after = (drawn.effect_deg[drawn.at == run] for run in (0.0, 1.0))
    assert np.ptp(before) == np.ptp(after) == 0.0
    assert after[0] - before[0] == pytest.approx(effects[0]["parameters"]["deg"]["value"])
    with pytest.raises(DiagnosisError, match="run 18"):
        partial_residuals([runs[0], []], effects, ["17", "18"])


def test_runs_without_poses_leave_the_others_their_names():
    r = responses_of([[], run_of(AS_IT_WAS, 1), [], run_of(AS_IT_WAS, 2)], ["a", "b", "c", "d"])
    assert r.run_ids == ("b", "d")
    assert np.unique(r.run).tolist() == [0, 1]


@pytest.mark.statistical
@pytest.mark.timeout(600)
@pytest.mark.parametrize("noise", [WHITE, Noise("ar1", 0.6)], ids=["white", "AR 0.6"])
def test_of_pairs_of_runs_that_do_not_differ_few_are_accused(noise):
    found: list[Findings] = []
    for seed in range(24):
        pair = [run_of(AS_IT_WAS, 1000 + 2 * seed + k, noise) for k in range(2)]
        found.append(diagnose(pair, bootstraps=199, cross_fit=False).findings)
    assert sum(bool(one.found) for one in found) <= 3  # at 2 % more than three of 24 are one case in 1,000


def test_the_choice_of_the_runs_costs_two_parameters_and_a_bias_that_changes_one_in_all() -> None:
    """Zhang & Siegmund (2007): one of n change points costs 2·log n."""
    single = {
        (c.changed is not None, c.name, c.shape.form): c
        for c in candidates_of(responses_of([run_of(AS_IT_WAS, 1), run_of(AS_IT_WAS, 2)]))
        if c.beside is None and not c.shape.scanned
    }
    for form in (("backlash", ""), ("accelerometer_offset", "both"), ("stage_eccentricity", "")):
        assert single[True, *form].parameters == single[False, *form].parameters + 2
    assert single[True, "mount_change", ""].parameters == 1
