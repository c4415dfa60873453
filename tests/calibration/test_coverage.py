"""The coverage factor: what it says it covers is covered, whatever the two errors look like."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calrig.calibration.line import fit_line
from calrig.calibration.uncertainty.budget import Reference, uncertainty
from calrig.calibration.uncertainty.coverage import coverage_factor
from tests.studies.correlated_poses import covered_by_k

HALF_A_DEGREE = 0.5 / math.sqrt(3.0)


def test_a_limit_of_half_a_degree_alone_has_a_k_of_1_65_and_0_48_degrees():
    k = coverage_factor(0.0, 10.0, HALF_A_DEGREE, "rectangular")
    assert round(k, 2) == 1.65
    assert k * HALF_A_DEGREE == pytest.approx(0.475)


@pytest.mark.parametrize(("freedom", "k"), [(1e9, 1.96), (10.0, 2.228), (4.0, 2.776), (1.0, 12.706)])
def test_noise_alone_has_students_k(freedom, k):
    assert coverage_factor(0.02, freedom, 0.0, "rectangular") == pytest.approx(k, rel=1e-3)


def test_a_normal_stage_alone_has_the_normal_k():
    assert coverage_factor(0.0, 4.0, 1.0, "normal") == pytest.approx(1.960, abs=1e-3)


@pytest.mark.parametrize("distribution", ["rectangular", "normal"])
@pytest.mark.parametrize(("freedom", "of_noise"), [(1, 1.0), (3, 1.0), (24, 0.1), (50, 3.0), (10**7, 1.0)])
def test_noise_and_a_stage_together_are_covered(freedom, of_noise, distribution):
    """Drawn, where the program convolves."""
    rng = np.random.default_rng(1)
    n = 400_000
    of_stage = rng.uniform(-1.0, 1.0, n) * math.sqrt(3.0)
    if distribution == "normal":
        of_stage = rng.standard_normal(n)
    drawn = of_noise * rng.standard_t(freedom, n) + of_stage
    expanded = coverage_factor(of_noise, freedom, 1.0, distribution) * math.hypot(of_noise, 1.0)
    assert np.mean(np.abs(drawn) <= expanded) == pytest.approx(0.95, abs=0.0014)  # four standard errors


@pytest.mark.statistical
@pytest.mark.parametrize("n_poses", [3, 4, 8, 26])
def test_few_poses_and_a_normal_stage_are_covered(n_poses):
    """Each type A is estimated from its own poses; 4,000 draws are known to 0.0034."""
    covered, _ = covered_by_k(n_poses, 1.0, 4000)
    assert covered > 0.945 - 0.007


@pytest.mark.statistical
@pytest.mark.parametrize(("n", "kind"), [(5, "common"), (26, "common"), (26, "harmonic"), (8, "setting")])
def test_a_calibrated_reading_lies_within_the_expanded_uncertainty_in_ninety_five_of_a_hundred(n, kind):
    """Calibrations on stages with a limit of ±0.05°, each used for one new reading somewhere in the range."""
    rng = np.random.default_rng(2)
    stage = Reference(0.05 / math.sqrt(3.0), kind)
    theta_deg = np.linspace(-60.0, 60.0, n)
    covered, trials = 0, 800
    for _ in range(trials):
        line = fit_line(theta_deg, theta_deg + rng.normal(0.0, 0.02, n) - _stage_deg(stage, theta_deg, rng))
        where = rng.uniform(-60.0, 60.0)
        error_deg = (where + rng.normal(0.0, 0.02) - line.bias_deg) / line.scale - where
        covered += abs(error_deg) <= uncertainty(line, theta_deg, stage).expanded_deg
    most = 0.999 if kind == "setting" else 0.995  # a harmonic error is given whole, a setting's counts twice
    assert 0.927 <= covered / trials <= most


def _stage_deg(stage, theta_deg, rng):
    limit_deg = stage.std_deg * math.sqrt(3.0)
    if stage.kind == "common":
        return np.full(len(theta_deg), rng.uniform(-limit_deg, limit_deg))
    if stage.kind == "setting":
        return rng.uniform(-limit_deg, limit_deg, len(theta_deg))
    point = rng.normal(size=3)  # on a sphere: rectangular in each direction
    a, b, _ = limit_deg * point / np.linalg.norm(point)
    return a * np.sin(np.radians(theta_deg)) + b * np.cos(np.radians(theta_deg))
