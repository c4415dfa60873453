"""A run that ends as soon as it is good enough: what it states covers as much as of one that goes on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calrig.calibration.plan_design import dwell_designs, ended, sweep_designs
from calrig.calibration.plan_design.design_problem import Design, DesignProblem, Goals, Sweeping, TypeB
from calrig.calibration.plan_design.layout import Pace, Precision, Sweep, Turning
from calrig.model.result import Reference
from calrig.plan import Plan

from . import coverage


@pytest.mark.statistical
@pytest.mark.parametrize(("times", "share"), [(2.5, 1.0), (2.0, 0.5)])
def test_ending_early_does_not_shrink_what_is_covered(times, share):
    found = coverage.covered(coverage.designed(28), times, share, 400, seed=3)
    chance = 3 * (0.95 * 0.05 / 400) ** 0.5
    assert found.early > 0.1
    assert min(found.elevation, found.bias, found.scale) > 0.95 - chance


@pytest.mark.statistical
def test_noise_that_dwells_share_does_not_end_a_run_too_early():
    """By least squares, of 200 such runs 62 % of biases and 72 % of scales are within two standard errors."""
    found = coverage.covered(Plan(), 2.5, 0.5, 200, seed=1, correlation=0.6)
    assert found.early > 0.5
    assert (found.bias > 0.84, found.scale > 0.79, found.elevation > 0.9) == (True, True, True)


@pytest.mark.statistical
def test_a_sweep_that_ends_early_has_turned_both_ways_and_covers_as_much():
    found = coverage.covered(coverage.turning(4), 2.5, 1.0, 400, seed=3)
    chance = 3 * (0.95 * 0.05 / 400) ** 0.5
    assert found.early > 0.5
    assert found.poses > 32  # two passes of 15 stretches, and their dwells
    assert min(found.elevation, found.bias, found.scale) > 0.95 - chance


def expected(plan: Plan, times: float) -> tuple[Design, coverage.Covered]:
    """What a design says of a plan of dwells of 1 s, or of its sweep, without moves; and 150 runs of it."""
    reference = TypeB(1e-9, Reference(std_deg=1e-9, kind="setting", distribution="normal"))
    precision, pace = Precision(0.0, coverage.SCATTER_DEG, ""), Pace(lambda _: 0.0, 0.0, 0.0, 0.0)
    task = DesignProblem((-60.0, 60.0), precision, pace, reference, trace=False, until=True)
    if plan.kind == "sweep":
        task = replace(task, sweeping=Sweeping(Turning(20.0, 80.0), precision))
        design = sweep_designs.made(task, task.sweeping, Sweep((-60.0, 60.0), plan.sweeps, 15, plan.dwell_s))
    else:
        design = dwell_designs.made(task, list(plan.elevations_deg), 1.0)
    said = ended(task, Goals(expanded_deg=times * coverage.SCATTER_DEG), design)
    return said, coverage.covered(plan, times, 1.0, 150, seed=5)


@pytest.mark.statistical
@pytest.mark.parametrize("times", [2.2, 2.5, 3.0])
def test_a_design_says_the_mean_time_of_runs_that_end_early(times):
    """Mean time, poses and uncertainty, not those of where it ends as expected (14 for 16 s at 3)."""
    said, runs = expected(coverage.designed(28), times)
    assert said.duration_s == pytest.approx(runs.poses, rel=0.05)
    assert len(said.elevations_deg) == pytest.approx(runs.poses, rel=0.05)
    assert said.expanded_deg == pytest.approx(runs.expanded_deg, rel=0.05)


@pytest.mark.statistical
@pytest.mark.parametrize("times", [2.2, 2.5])
def test_a_design_of_a_sweep_says_the_means_too(times):
    """A third or a fourth traverse is needed by chance: at 2.5 the second suffices for most runs only."""
    said, runs = expected(coverage.turning(4), times)
    assert len(said.elevations_deg) == pytest.approx(runs.poses, rel=0.07)
    assert said.expanded_deg == pytest.approx(runs.expanded_deg, rel=0.07)
    assert said.duration_s == pytest.approx(2.15 * runs.poses, rel=0.07), "2.1 s a pose, and run-ups"
