"""What of the blind board stands out on the screen of a fleet: noise rarely, what a diagnosis sees does."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.fleet_screen import LEVEL, screen
from calrig.calibration.packed_poses import packed
from studies.blind.board import Rate
from studies.blind.cells import CELLS

from .limit_runs import MAKES, at_the_limit
from .made import fleet

EFFECTS = [name for name, cell in CELLS.items() if cell.kind != "null"]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.statistical)])
def test_of_white_noise_fewer_stand_out_than_the_level(seed):
    stood_out = screen(fleet(5_000, seed)).stands_out
    assert Rate(int(stood_out.sum()), len(stood_out)).interval[1] <= LEVEL


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_the_board_stands_out(name):
    assert screen(packed({str(k): CELLS[name].run(k).poses for k in range(2)})).stands_out.all()


def test_correlated_noise_stands_out_as_only_a_diagnosis_can_judge_it():
    assert screen(fleet(300, 1, cell="null AR 0.6 each")).stands_out.mean() > 0.9


@pytest.mark.statistical
@pytest.mark.timeout(900)
def test_what_a_diagnosis_just_sees_stands_out():
    """Each of the 17 causes at a distance of 40 in −2 log likelihood, pooled: 95 % or more."""
    seeds = range(20)
    runs = {f"{name} {seed}": at_the_limit(name, seed) for name in MAKES for seed in seeds}
    stood_out = screen(packed(runs)).stands_out.reshape(len(MAKES), len(seeds))
    rates = dict(zip(MAKES, stood_out.mean(axis=1).tolist(), strict=True))
    assert stood_out.mean() >= 0.95, rates
    assert min(rates.values()) >= 0.75, rates  # of 20; one that holds 95 % falls short of that in 3e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKES)
def test_each_cause_that_a_diagnosis_just_sees_stands_out(name):
    """The same, each by itself in 400 runs."""
    stood_out = screen(packed({str(k): at_the_limit(name, 1_000 + k) for k in range(400)})).stands_out
    assert Rate(int(np.count_nonzero(stood_out)), 400).interval[1] >= 0.95
