"""What a design promises, held against runs of it; and that it is worth its name."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.fit import fit_line
from calrig.calibration.plan_design.design import quickest, within
from calrig.calibration.plan_design.goals import Goals
from calrig.calibration.plan_design.layout import layout
from calrig.calibration.plan_design.limit import limit_s
from calrig.calibration.plan_design.rig_figures import precision_of_run
from calrig.calibration.plan_design.suspects import imagined_dwells, suspects
from calrig.calibration.plan_design.task import OutOfReachError
from calrig.calibration.uncertainty import Reference, uncertainty
from calrig.plan import Plan
from calrig.runs.rig_pace import HOMING_AND_START_S, QUESTIONS_S

from . import trial

MAP = Reference(0.003, "harmonic", "normal")
STAGE = Reference(0.29)


def fixed_s() -> float:
    poses = [pose.target_deg for pose in Plan().poses((-90.0, 90.0))]
    moves_s = sum(trial.travel_s(abs(b - a)) for a, b in zip([0.0, *poses], poses, strict=False))
    return HOMING_AND_START_S + moves_s + len(poses) * (1.0 + 2.0 + QUESTIONS_S)


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
    wanted_deg = stated_deg([pose.target_deg for pose in Plan().poses((-90.0, 90.0))], 2.0, reference)
    goals = Goals(wanted_deg)
    design = quickest(task, goals)
    assert design.sweep is not None
    assert stated_deg(design.elevations_deg, design.dwell_s, reference) == pytest.approx(wanted_deg, rel=0.1)
    assert design.duration_s < 0.57 * fixed_s()
    assert design.duration_s < 1.3 * limit_s(task, goals)
    fixed = trial.fixed()
    scatter_deg = trial.PRECISION.scatter_deg(fixed.dwell_s)
    shown = suspects(imagined_dwells(fixed.target_deg.tolist(), fixed.dwell_s, trial.PACE), scatter_deg)
    least_deg = {one.name: one.rms_deg for one in shown}
    hidden = {one.name for one in design.suspects if one.rms_deg > 1.15 * least_deg[one.name]}
    # one that dwells alone show, and one that they show better: means over stretches hide a short wave
    assert hidden == {"settling", "stage_periodic"}
    poses = design.sweep.plan(seed=3).poses((-90.0, 90.0))
    assert len(poses) == len(design.elevations_deg) == len(design.sweep)


def test_what_the_stage_is_worth_is_a_limit_that_is_said_with_what_would_help():
    with pytest.raises(OutOfReachError, match=r"0\.477° is left however many poses.*calrig solve"):
        quickest(trial.task(STAGE, trace=False), Goals(expanded_deg=0.4))


def test_scatter_that_no_dwell_averages_out_is_said_to_have_a_cause():
    task = trial.task(MAP, trace=False)
    scattered = precision_of_run("7", dwell_s=2.0, stderr_deg=0.01, scatter_deg=0.1)
    with pytest.raises(OutOfReachError, match="diagnose that run"):
        quickest(type(task)(task.range_deg, scattered, task.pace, task.type_b, trace=False), Goals(0.05))


def test_more_time_is_never_worth_less():
    task = trial.task(MAP, trace=False)
    known = [within(task, time_s) for time_s in (25.0, 50.0, 100.0, 200.0)]
    assert [design.duration_s <= t for design, t in zip(known, (25, 50, 100, 200), strict=True)] == [True] * 4
    uncertainties = [design.expanded_deg for design in known]
    assert uncertainties == sorted(uncertainties, reverse=True)


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
