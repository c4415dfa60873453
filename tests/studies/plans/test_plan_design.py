"""What a design promises, held against runs of it; and that it is worth its name."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from calrig.calibration.line import fit_line
from calrig.calibration.plan_design.design import allowed_deg, limit_s, quickest, within
from calrig.calibration.plan_design.design_problem import (
    DesignProblem,
    Goals,
    OutOfReachError,
    Sweeping,
    TypeB,
)
from calrig.calibration.plan_design.layout import Pace, Precision, Turning, layout, precision_of_run
from calrig.calibration.plan_design.smallest_effects import imagined_dwells, suspects
from calrig.calibration.uncertainty.budget import Reference, uncertainty
from calrig.instruments.axis import travel_time_s
from calrig.plan import Plan
from calrig.runs.plan_estimates import HOMING_S, QUESTIONS_S, START_S

from . import trial

MAP = Reference(0.003, "harmonic", "normal")
STAGE = Reference(0.29)


def fixed_s() -> float:
    poses = [pose.target_deg for pose in Plan().poses((-90.0, 90.0))]
    moves_s = sum(trial.travel_s(abs(b - a)) for a, b in zip([0.0, *poses], poses, strict=False))
    return HOMING_S + START_S + moves_s + len(poses) * (1.0 + 2.0 + QUESTIONS_S)


def stated_deg(order, dwell_s, reference, runs=200):
    """What runs of noise alone state as their expanded uncertainty, as a root mean square."""
    rng, theta = np.random.default_rng(5), np.array(order)
    scatter_deg = trial.PRECISION.scatter_deg(dwell_s)
    lines = (fit_line(theta, theta + scatter_deg * rng.standard_normal(len(theta))) for _ in range(runs))
    return float(np.sqrt(np.mean([uncertainty(line, theta, reference).expanded_deg ** 2 for line in lines])))


@pytest.mark.parametrize("reference", [MAP, STAGE])
@pytest.mark.parametrize(("trace", "share"), [(True, 0.6), (False, 0.35)])
def test_the_uncertainty_of_the_fixed_plan_is_reached_in_a_share_of_its_time(reference, trace, share):
    task = trial.task(reference, trace=trace)
    wanted_deg = stated_deg([pose.target_deg for pose in Plan().poses((-90.0, 90.0))], 2.0, reference)
    design = quickest(task, Goals(expanded_deg=wanted_deg))
    assert stated_deg(design.elevations_deg, design.dwell_s, reference) == pytest.approx(wanted_deg, rel=0.1)
    assert design.duration_s < share * fixed_s()
    assert design.duration_s < 1.3 * limit_s(task, Goals(expanded_deg=wanted_deg))


@pytest.mark.parametrize("reference", [MAP, STAGE])
def test_turning_without_stopping_shows_as_much_as_the_fixed_plan_in_little_more_than_half_of_its_time(
    reference,
):
    task = trial.task(reference, trace=True, sweeping=True)
    wanted_deg = trial.expected_deg(trial.fixed(), reference)
    goals = Goals(wanted_deg)
    design = quickest(task, goals)
    assert design.sweep is not None
    assert stated_deg(design.elevations_deg, design.dwell_s, reference) == pytest.approx(wanted_deg, rel=0.1)
    # as uncertain and with as much shown it holds the fixed plan's own data: 104 s of 206 s
    assert design.duration_s < 0.58 * fixed_s()
    assert design.duration_s < 1.3 * limit_s(task, goals)
    least_deg = {one.name: one.rms_deg for one in shown_by_the_fixed_plan()}
    hidden = {one.name for one in design.suspects if one.rms_deg > 1.15 * least_deg[one.name]}
    # one that dwells alone show, and one that they show better: means over stretches hide a short wave
    assert hidden == {"settling", "stage_periodic"}
    of_time = {one.name: one.rms_deg for one in design.suspects if one.name in ("time_drift", "mount_slip")}
    assert all(rms_deg <= 1.001 * least_deg[name] for name, rms_deg in of_time.items())
    poses = design.sweep.plan(seed=3).poses((-90.0, 90.0))
    assert len(poses) == len(design.elevations_deg) == len(design.sweep)


def shown_by_the_fixed_plan():
    fixed = trial.fixed()
    poses = imagined_dwells(fixed.target_deg.tolist(), fixed.dwell_s, trial.PACE)
    return suspects(poses, trial.PRECISION.scatter_deg(fixed.dwell_s))


def test_what_may_stay_hidden_is_what_the_fixed_plan_hides_of_a_drift():
    goals = Goals(trial.expected_deg(trial.fixed(), MAP))
    drift = next(one for one in shown_by_the_fixed_plan() if one.name == "time_drift")
    allowed = allowed_deg(trial.task(MAP, trace=True, sweeping=True), goals, math.nan)
    assert allowed == pytest.approx(drift.rms_deg, rel=1e-3)


@pytest.mark.parametrize("stands_deg", [-60.0, 55.0])
def test_turns_begin_at_the_end_that_is_nearer_to_the_stage(stands_deg):
    task = trial.task(MAP, trace=True, sweeping=True)
    near_deg = math.copysign(60.0, stands_deg)
    design = within(replace(task, pace=replace(task.pace, stands_deg=stands_deg)), 100.0)
    assert design.sweep is not None
    poses = design.sweep.plan(seed=1).poses((-60.0, 60.0))
    assert design.elevations_deg[0] == poses[0].target_deg == near_deg
    assert poses[1].stretch_deg[0] == near_deg
    assert design.duration_s <= 100.0


def test_what_the_stage_is_worth_is_a_limit_that_is_said_with_what_would_help():
    with pytest.raises(OutOfReachError, match=r"0\.477°.* a stage certificate .* or a stage map"):
        quickest(trial.task(STAGE, trace=False), Goals(expanded_deg=0.4))


def test_a_reference_with_an_error_of_each_setting_counts_as_results_count_it():
    settings = Reference(0.05, "setting")
    design = quickest(trial.task(settings, trace=False), Goals(expanded_deg=0.04))
    assert design.expanded_deg == pytest.approx(0.04, rel=0.02)
    assert stated_deg(design.elevations_deg, design.dwell_s, settings) == pytest.approx(0.04, rel=0.1)


def test_scatter_that_no_dwell_averages_out_is_said_to_have_a_cause():
    task = trial.task(MAP, trace=False)
    scattered = precision_of_run("7", dwell_s=2.0, stderr_deg=0.01, scatter_deg=0.1, freedom=50)
    with pytest.raises(OutOfReachError, match="diagnose that run"):
        quickest(type(task)(task.range_deg, scattered, task.pace, task.type_b, trace=False), Goals(0.05))


def test_what_chance_makes_of_noise_is_no_scatter_from_pose_to_pose():
    residuals = 0.01 * np.sqrt(np.random.default_rng(1).chisquare(50, 400) / 50)
    found = [precision_of_run("7", 2.0, 0.01, float(one), 50).pose_deg for one in residuals]
    assert np.mean(np.array(found) > 0.0) == pytest.approx(0.05, abs=0.03)
    more = precision_of_run("7", 2.0, 0.01, 0.0141, 50)
    assert more.pose_deg == pytest.approx(0.01, rel=0.01)


@pytest.mark.parametrize(("trace", "sweeping"), [(False, False), (True, True)])
def test_more_time_is_never_worth_less_and_no_plan_reaches_as_much_in_less_than_is_said(trace, sweeping):
    task = trial.task(MAP, trace=trace, sweeping=sweeping)
    times_s = (60.0, 100.0, 200.0) if trace else (25.0, 50.0, 100.0, 200.0)
    known = [within(task, time_s) for time_s in times_s]
    assert all(design.duration_s <= time_s for design, time_s in zip(known, times_s, strict=True))
    uncertainties = [design.expanded_deg for design in known]
    assert uncertainties == sorted(uncertainties, reverse=True)
    for design in known:
        reached = Goals(design.expanded_deg, design.bias_std_deg, design.scale_std)
        least_s = limit_s(task, reached, must_show=False)
        assert 0.5 * design.duration_s < least_s <= design.duration_s


@pytest.mark.parametrize(
    ("velocity_dps", "acceleration_dps2", "range_deg", "white_deg_rts", "stands_deg", "trace"),
    [(2.0, 1.0, (-10.0, 10.0), 0.01, 0.0, True), (180.0, 900.0, (-80.0, 80.0), 0.05, 80.0, False)],
)
def test_no_design_is_under_the_limit_on_slow_and_fast_stages(
    velocity_dps, acceleration_dps2, range_deg, white_deg_rts, stands_deg, trace
):
    pace = Pace(
        lambda way_deg: travel_time_s(way_deg, velocity_dps, acceleration_dps2), 0.5, 0.2, 2.0, stands_deg
    )
    precision = Precision(white_deg_rts, 0.0, "made up")
    turns = Sweeping(Turning(velocity_dps, acceleration_dps2), precision)
    task = DesignProblem(range_deg, precision, pace, TypeB(0.003, MAP), trace, sweeping=turns)
    for goals in (Goals(3.0 * white_deg_rts), Goals(3.0 * white_deg_rts, white_deg_rts / 8.0)):
        assert limit_s(task, goals) <= quickest(task, goals).duration_s


@pytest.mark.parametrize("sweeping", [False, True])
def test_what_is_said_to_be_needed_at_the_least_is_enough(sweeping):
    task = trial.task(MAP, trace=sweeping, sweeping=sweeping)
    with pytest.raises(OutOfReachError, match=r"5 s are too few: .* take \d+ s") as refused:
        within(task, 5.0)
    said_s = float(str(refused.value).split()[-2])
    assert within(task, said_s).duration_s == pytest.approx(said_s, abs=2.0)
    with pytest.raises(OutOfReachError):
        within(task, said_s - 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_layout_visits_both_ends_and_comes_from_both_sides(seed):
    order = layout((-60.0, 40.0), 24, 4, 0.3, np.random.default_rng(seed))
    assert (min(order), max(order)) == (-60.0, 40.0)
    moves = np.diff(order)
    assert 0.3 < np.mean(moves > 0) < 0.7
    assert len(set(np.round(np.abs(moves), 2))) > len(moves) / 2  # no one length that settling could hide in


def test_standard_errors_are_goals_as_well():
    goals = Goals(bias_std_deg=0.004, scale_std=2e-4)
    design = quickest(trial.task(STAGE, trace=False), goals)
    assert design.bias_std_deg <= 0.004
    assert design.scale_std <= 2e-4
