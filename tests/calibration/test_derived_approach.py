"""Poses whose order is known tell from where each was come to, also without a column `approach`."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed
from support import one_now

from calrig.calibration.diagnosis.tracing import diagnose, document, trace
from calrig.calibration.regression.motion import DERIVED_APPROACH, with_approach
from calrig.calibration.regression.request import AS_USUAL, DiagnosisRequest
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.results.correction import fit_line_with_effects, numbers_of
from calrig.calibration.results.pose_errors import angles_deg, circumstances, readings_left_deg

PLAY_DEG = 0.2
KNOWN = DiagnosisRequest(periods_deg=(5.0,))


def triangle_deg():
    up = np.linspace(-60.0, 60.0, 25)
    return np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])


def with_play(theta_deg, noise_deg, seed, growth=0.0, **columns):
    """Poses of a stage with play; `growth` is its share more at each 60° of elevation."""
    noise = noise_deg * np.random.default_rng(seed).standard_normal(len(theta_deg))
    sense = np.sign(np.diff(theta_deg, prepend=theta_deg[0] - 1.0))
    play_deg = PLAY_DEG * (1.0 + growth * theta_deg / 60.0)
    reading_deg = 0.3 + 1.001 * theta_deg + play_deg / 2.0 * sense + noise
    return posed(target_deg=theta_deg, reading_deg=reading_deg, **columns)


def effects_in(poses):
    """Those that a diagnosis finds, without its errors on held-out poses."""
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])["effects"]


@pytest.mark.parametrize("column", one_now(["time_s", "pass"]))
def test_play_of_a_triangle_without_approach_is_backlash_and_no_slip(column):
    theta_deg = triangle_deg()
    order = {"time_s": 4.0 * np.arange(97), "pass": np.arange(97) // 25}[column]
    found = trace([with_play(theta_deg, 0.01, 0, **{column: order})], ["1"])
    assert [(e["name"], e["verdict"]) for e in found["effects"]] == [("backlash", "named")]
    assert found["effects"][0]["parameters"]["backlash_deg"]["value"] == pytest.approx(PLAY_DEG, abs=0.01)
    assert found["final"]["held_out_rms_deg"] < 0.2 * found["base"]["held_out_rms_deg"]
    assert DERIVED_APPROACH in found["warnings"]


def test_an_accepted_play_is_applied_to_the_poses_that_it_was_found_in():
    poses = with_play(triangle_deg(), 0.01, 0, time_s=4.0 * np.arange(97))
    (play,) = effects_in(poses)
    effects = [(play["name"], numbers_of(play["parameters"]))]
    line = fit_line_with_effects(*angles_deg(poses), effects, circumstances(poses))
    left_deg = readings_left_deg(poses, line, effects)
    assert np.std(left_deg) < 0.015


@pytest.mark.parametrize("seed", one_now(range(3)))
def test_play_of_27_rests_in_any_order_is_found(seed):
    theta_deg = np.random.default_rng(seed).permutation(np.linspace(-65.0, 65.0, 27))
    found = effects_in(with_play(theta_deg, 0.03, seed, time_s=20.0 * np.arange(27)))
    assert [(e["name"], e["verdict"]) for e in found] == [("backlash", "named")]


@pytest.mark.parametrize("seed", one_now(range(3)))
def test_play_that_grows_along_the_range_is_backlash_with_its_growth(seed):
    poses = with_play(triangle_deg(), 0.03, seed, growth=1.0, time_s=4.0 * np.arange(97))
    (effect,) = effects_in(poses)
    assert (effect["name"], effect["verdict"]) == ("backlash", "named")
    known = {"backlash_deg": PLAY_DEG, "growth_deg_per_deg": PLAY_DEG / 60.0, "middle_deg": 0.0}
    assert effect["parameters"].keys() == known.keys()
    for name, value in known.items():
        stated = effect["parameters"][name]
        assert abs(stated["value"] - value) <= 3.0 * (stated["std"] or 0.0)


@pytest.mark.parametrize("seed", one_now(range(3)))
def test_a_difference_by_direction_that_changes_its_sign_is_no_play(seed):
    poses = with_play(triangle_deg(), 0.03, seed, growth=4.0, time_s=4.0 * np.arange(97))
    found = effects_in(poses)
    assert all("growth_deg_per_deg" not in effect["parameters"] for effect in found)
    assert any(effect["covariate"] == "approach·target_deg" for effect in found)


@pytest.mark.parametrize(("apart_deg", "request_"), [(90.0, AS_USUAL), (180.0, KNOWN)], ids=["90", "180"])
def test_a_periodic_error_of_another_phase_each_way_is_a_mean_and_a_difference(apart_deg, request_):
    """As a stepper under friction has it; 180° apart no mean is left, and the period is stated."""
    rng = np.random.default_rng(5)
    up_deg = np.sort(rng.uniform(0.0, 360.0, 300))
    theta_deg, up = np.concatenate([up_deg, up_deg[::-1]]), np.repeat([1.0, -1.0], 300)
    wave_deg = 0.12 * np.sin(np.radians(72.0 * theta_deg + 0.5 * apart_deg * up))
    reading_deg = theta_deg + wave_deg + 0.02 * rng.standard_normal(600)
    poses = posed(target_deg=theta_deg, reading_deg=reading_deg, time_s=1.5 * np.arange(600))
    found = trace([poses], ["1"], request=request_)
    mean_deg, difference_deg = (0.12 * f(np.radians(apart_deg / 2.0)) for f in (np.cos, np.sin))
    difference = next(e for e in found["effects"] if e["covariate"] == "approach·target_deg")
    size = difference["parameters"]["size_deg"]
    assert difference["parameters"]["period"]["value"] == pytest.approx(5.0, abs=0.002)
    assert abs(size["value"] - 2.0 * difference_deg) <= 4.0 * size["std"]
    means = [e["parameters"]["amplitude_deg"] for e in found["effects"] if e["name"] == "stage_periodic"]
    assert len(means) == (mean_deg > 0.01)
    assert all(abs(mean["value"] - mean_deg) <= 4.0 * mean["std"] for mean in means)
    assert found["final"]["held_out_rms_deg"] == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize("shift", one_now([0.55, 0.5]))
def test_a_difference_by_direction_on_two_grids_is_no_short_period(shift):
    """Each way 5° apart: between the two grids, a wave of 2.52° or 5.07° takes the values of one of 360°."""
    rng = np.random.default_rng(1)
    up_deg, down_deg = np.arange(0.0, 360.0, 5.0), np.arange(360.0 - 5.0 * shift, 0.0, -5.0)
    theta_deg = np.concatenate([up_deg, down_deg])
    way = np.concatenate([np.ones(len(up_deg)), -np.ones(len(down_deg))])
    once_deg, twice_deg = (
        0.05 * np.cos(np.radians(theta_deg) + 0.5),
        0.5 * np.sin(np.radians(2.0 * theta_deg)),
    )
    reading_deg = theta_deg + twice_deg + way * once_deg + 0.003 * rng.standard_normal(len(theta_deg))
    poses = posed(
        target_deg=theta_deg, reading_deg=reading_deg, approach=way, time_s=5.0 * np.arange(len(way))
    )
    found = trace([poses], ["1"], request=DiagnosisRequest("good"))
    twice, difference = found["effects"]
    assert (twice["name"], twice["parameters"]["period_deg"]["value"]) == ("stage_periodic", 180.0)
    assert difference["covariate"] == "approach·target_deg"
    assert difference["parameters"]["period"]["value"] == 360.0
    assert difference["parameters"]["size_deg"]["value"] == pytest.approx(0.1, abs=0.004)
    assert found["final"]["held_out_rms_deg"] < 1.2 * 0.003


def test_a_wavy_difference_by_direction_is_found_beside_a_wavy_curve():
    """Residuals of both follow each other from pose to pose, as slow noise does."""
    rng = np.random.default_rng(2)
    up_deg = np.arange(90.0, 273.5)
    theta_deg = np.concatenate([up_deg, up_deg[::-1]]) + rng.normal(0.0, 0.2, 368)
    way, angle = np.repeat([1.0, -1.0], 184), np.radians(theta_deg)
    curve_deg = sum(
        a * np.cos(k * angle + p) for k, a, p in [(1, 1.5, 0.3), (2, 1, 1), (3, 0.6, 2), (5, 0.5, 0.4)]
    )
    half_deg = 0.2 * (1.0 + np.cos(2.0 * angle + 1.0) + np.cos(4.0 * angle + 2.0) + np.cos(7.0 * angle))
    reading_deg = theta_deg + curve_deg + way * half_deg + rng.normal(0.0, 0.03, 368)
    poses = posed(target_deg=theta_deg, reading_deg=reading_deg, approach=way)
    found = trace([poses], ["1"], request=DiagnosisRequest("good"))
    (play,) = [e for e in found["effects"] if e["name"] == "backlash"]
    assert play["parameters"]["backlash_deg"]["value"] == pytest.approx(0.4, abs=0.03)
    assert found["final"]["held_out_rms_deg"] < 1.2 * 0.03
    assert found["final"]["blocked_rms_deg"] < found["base"]["blocked_rms_deg"]


def test_a_stage_that_was_asked_for_no_step_came_as_it_did_before():
    theta_deg = np.array([0.0, 10.0, 10.0001, 20.0, 19.9999, 10.0, 10.0, 20.0])
    poses = posed(target_deg=theta_deg, reading_deg=theta_deg, time_s=4.0 * np.arange(8))
    ((run,), is_derived) = with_approach([poses])
    assert [pose.approach for pose in run] == [0, 1, 1, 1, 1, -1, -1, 1]
    assert is_derived
    assert responses_of([poses]).approach.tolist() == [0, 1, 1, 1, 1, -1, -1, 1]


@pytest.mark.parametrize("columns", [{}, {"time_s": 4.0 * np.arange(97), "approach": np.ones(97)}])
def test_without_an_order_or_with_an_approach_nothing_is_derived(columns):
    poses = with_play(triangle_deg(), 0.01, 0, **columns)
    ((run,), is_derived) = with_approach([poses])
    assert run == poses
    assert not is_derived


def test_a_diagnosis_of_nothing_states_no_error_after():
    """Slow wandering that each fold explains by itself, and that all poses together leave to noise."""
    rng = np.random.default_rng(3)
    theta_deg = triangle_deg()
    for _ in range(3):
        wander_deg = 0.02 * np.cumsum(rng.standard_normal(97))
        poses = posed(target_deg=theta_deg, reading_deg=theta_deg + wander_deg, time_s=4.0 * np.arange(97))
        found = trace([poses], ["1"])
        before_deg, after_deg = (found[model]["held_out_rms_deg"] for model in ("base", "final"))
        assert (after_deg == before_deg) is (found["verdict"] == "nothing")
        assert after_deg <= before_deg
        assert found["effects"] or DERIVED_APPROACH not in found["warnings"]
