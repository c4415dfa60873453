"""Uncertainty of a calibrated reading: type A by simulation, type B as the reference states it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from calrig.calibration.line import fit_line
from calrig.calibration.uncertainty.budget import Reference, reference_part, uncertainty

STAGE = Reference(std_deg=0.29)


@pytest.mark.statistical
def test_type_a_is_the_error_of_new_readings_under_new_calibrations():
    """4000 calibrations of 96 poses, each applied to one new reading anywhere in the range."""
    rng = np.random.default_rng(0)
    theta_deg = np.tile([-20.0, -5.0, 10.0, 25.0, 40.0, 60.0], 16)
    squared_error, squared_stated = [], []
    for _ in range(4000):
        line = fit_line(theta_deg, 0.4 + 0.8 * theta_deg + rng.normal(0.0, 0.1, 96))
        new_deg = rng.uniform(-20.0, 60.0)
        reading_deg = 0.4 + 0.8 * new_deg + rng.normal(0.0, 0.1)
        squared_error.append(((reading_deg - line.bias_deg) / line.scale - new_deg) ** 2)
        squared_stated.append(uncertainty(line, theta_deg, None).type_a_deg ** 2)

    assert math.sqrt(np.mean(squared_stated)) == pytest.approx(math.sqrt(np.mean(squared_error)), rel=0.04)


def test_no_number_of_poses_shrinks_the_references_share():
    rng = np.random.default_rng(1)
    theta_deg = np.tile(np.arange(-60.0, 61.0, 10.0), 200)
    line = fit_line(theta_deg, theta_deg + rng.normal(0.0, 0.01, len(theta_deg)))

    worth = uncertainty(line, theta_deg, STAGE)

    assert worth.type_b_deg == worth.reference_deg == 0.29
    assert worth.expanded_deg == pytest.approx(0.95 * math.sqrt(3.0) * 0.29, rel=0.01)
    assert worth.to_dict() == {
        "type_a_deg": worth.type_a_deg,
        "type_b_deg": 0.29,
        "reference_deg": 0.29,
        "reference_bias_deg": worth.bias_reference_std_deg,
        "reference_scale": worth.scale_reference_std,
    }


def test_without_a_stated_reference_the_expanded_uncertainty_is_unknown():
    theta_deg = np.array([0.0, 10.0, 20.0])
    line = fit_line(theta_deg, np.array([0.0, 10.1, 20.0]))

    worth = uncertainty(line, theta_deg, None)

    assert worth.type_a_deg is not None
    assert (worth.type_b_deg, worth.reference_deg, worth.expanded_deg) == (None, None, None)


@pytest.mark.parametrize(
    ("theta_deg", "reading_deg"),
    [([0.0, 10.0], [0.0, 10.1]), ([5.0] * 4, [5.1, 5.2, 5.0, 5.1]), ([0.0, 1.0, 2.0], [3.0, 3.0, 3.0])],
)
def test_too_little_to_tell_scatter_or_scale_leaves_type_a_unknown(theta_deg, reading_deg):
    line = fit_line(np.array(theta_deg), np.array(reading_deg))
    worth = uncertainty(line, np.array(theta_deg), STAGE)

    assert (worth.type_a_deg, worth.expanded_deg) == (None, None)
    assert worth.type_b_deg == 0.29


ARC_DEG = np.tile(np.arange(-30.0, 61.0, 10.0), 3)


def stage_errors_deg(kind, theta_deg, rng):
    """An error of 0.3° at every elevation, shared among the poses as the kind says."""
    if kind == "common":
        return np.full(len(theta_deg), rng.normal(0.0, 0.3))
    if kind == "harmonic":
        a, b = rng.normal(0.0, 0.3, 2)
        return a * np.sin(np.radians(theta_deg)) + b * np.cos(np.radians(theta_deg))
    return rng.normal(0.0, 0.3, len(theta_deg))


@pytest.mark.statistical
@pytest.mark.parametrize("kind", ["common", "harmonic", "setting"])
def test_bias_scale_and_elevation_scatter_over_stages_as_stated(kind):
    """4000 stages, each with an error of its own and a unit without noise: what scatters is the stage's."""
    rng = np.random.default_rng(2)
    anywhere_deg = np.linspace(-30.0, 60.0, 19)
    bias, scale, error = [], [], []
    for _ in range(4000):
        elevation_deg = ARC_DEG - stage_errors_deg(kind, ARC_DEG, rng)
        line = fit_line(ARC_DEG, 0.5 + 1.1 * elevation_deg)
        bias.append(line.bias_deg)
        scale.append(line.scale)
        error.append((0.5 + 1.1 * anywhere_deg - line.bias_deg) / line.scale - anywhere_deg)

    part = reference_part(ARC_DEG, 1.1, Reference(0.3, kind))

    assert part.bias_deg == pytest.approx(np.std(bias), rel=0.05)
    assert part.scale == pytest.approx(np.std(scale), rel=0.05, abs=1e-12)
    scatter_deg = math.sqrt(np.mean(np.square(error)))
    # of a harmonic error, the line takes up a little less than the whole, which is what is stated
    assert part.elevation_deg == pytest.approx(scatter_deg, rel=0.05)
    assert kind != "harmonic" or part.elevation_deg == 0.3


@pytest.mark.parametrize(("kind", "shrinks_by"), [("common", 1.0), ("harmonic", 1.0), ("setting", 10.0)])
def test_only_an_error_made_anew_at_each_pose_averages_out(kind, shrinks_by):
    stage = Reference(0.29, kind)
    few, many = (reference_part(theta, 1.0, stage) for theta in (ARC_DEG, np.tile(ARC_DEG, 100)))

    assert many.bias_deg == pytest.approx(few.bias_deg / shrinks_by)
    assert many.scale == pytest.approx(few.scale / shrinks_by, abs=1e-12)
    assert many.elevation_deg == pytest.approx(few.elevation_deg / shrinks_by)


def test_type_b_of_bias_and_scale_stand_beside_the_lines_own_errors():
    rng = np.random.default_rng(3)
    line = fit_line(ARC_DEG, ARC_DEG + rng.normal(0.0, 0.02, len(ARC_DEG)))

    worth = uncertainty(line, ARC_DEG, Reference(0.29, "common"))

    assert worth.bias_reference_std_deg == pytest.approx(0.29 * line.scale)
    assert worth.scale_reference_std == 0.0
    assert worth.expanded_deg == worth.coverage_factor * math.hypot(worth.type_a_deg, 0.29)


@pytest.mark.parametrize(("kind", "bias_deg"), [("common", 0.29), ("harmonic", 0.29), ("setting", 0.29 / 5)])
def test_at_one_angle_only_the_bias_has_a_share(kind, bias_deg):
    part = reference_part(np.full(25, 40.0), None, Reference(0.29, kind))

    assert (part.bias_deg, part.scale) == (pytest.approx(bias_deg), None)
    assert part.elevation_deg == pytest.approx(bias_deg)


@pytest.mark.parametrize("n_poses", [4, 6, 12])
def test_few_poses_have_students_factor_of_two_degrees_of_freedom_less(n_poses):
    """Student's t and a normal reference, convolved by scipy's quadrature, come to 95 %."""
    theta_deg = np.linspace(-60.0, 60.0, n_poses)
    line = fit_line(theta_deg, theta_deg + np.random.default_rng(n_poses).normal(0.0, 0.1, n_poses))
    worth = uncertainty(line, theta_deg, Reference(0.05, "common", "normal"))
    combined_deg = math.hypot(worth.type_a_deg, 0.05)
    assert worth.expanded_deg == pytest.approx(worth.coverage_factor * combined_deg, rel=1e-9)
    above, _ = quad(
        lambda of_stage: (
            norm.pdf(of_stage)
            * student.sf((worth.expanded_deg - 0.05 * of_stage) / worth.type_a_deg, n_poses - 2)
        ),
        -9.0,
        9.0,
    )
    assert 1.0 - 2.0 * above == pytest.approx(0.95, abs=5e-5)
