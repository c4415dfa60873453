"""A document applied: truth comes back, and the uncertainty given is true to its word."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.analysis.results import fitted
from calrig.calibration.poses import Pose
from calrig.calibration.regression.effect import Circumstances
from calrig.calibration.results.correction import Application, effects_on_reading_deg
from calrig.calibration.uncertainty.budget import Reference
from calrig.export.calibration_document import calibration_content

BIAS_DEG, SCALE, NOISE_DEG, STAGE_DEG = 0.25, 1.002, 0.05, 0.06


def calibrated(rng):
    """A document of 26 poses on a stage off by a harmonic of one turn, and the stage's own worth."""
    theta = np.repeat(np.linspace(-60.0, 60.0, 13), 2)
    sine, cosine = rng.normal(0.0, STAGE_DEG, 2)
    true = theta - sine * np.sin(np.radians(theta)) - cosine * np.cos(np.radians(theta))
    readings = BIAS_DEG + SCALE * true + rng.normal(0.0, NOISE_DEG, len(theta))
    poses = [Pose(t, r) for t, r in zip(theta.tolist(), readings.tolist(), strict=True)]
    reference = Reference(STAGE_DEG, "harmonic", "normal")
    provenance = {"reference": {"std_deg": STAGE_DEG, "kind": "harmonic", "distribution": "normal"}}
    result = fitted(poses, [], provenance)
    return calibration_content(unit="A", rig="b", poses=poses, result=result, reference=reference)


def test_two_standard_uncertainties_cover_95_percent_and_agree_with_the_documents_expanded_one():
    rng = np.random.default_rng(3)
    within = []
    for _ in range(300):
        document = calibrated(rng)
        application = Application.of_document(document)
        true = rng.uniform(-60.0, 60.0, 40)
        reading = BIAS_DEG + SCALE * true + rng.normal(0.0, NOISE_DEG, len(true))
        elevation = application.elevation_deg(reading, None)
        within.append(np.abs(elevation - true) < 2.0 * application.std_deg(elevation))
    assert 0.93 < np.mean(within) < 0.97
    over_range = application.std_deg(np.linspace(-60.0, 60.0, 2001))
    expanded = document["coverage_factor"] * np.sqrt(np.mean(over_range**2))
    assert expanded == pytest.approx(document["expanded_uncertainty_deg"], rel=1e-3)
    assert over_range[0] > over_range[1000], "the scale is known least at the ends"


def applied(**changes):
    return Application.of_document(
        {
            "range_deg": [-60.0, 60.0],
            "bias_deg": BIAS_DEG,
            "scale": SCALE,
            "covariance": None,
            "effects": [],
            "uncertainty": {"type_a_deg": 0.03, "type_b_deg": 0.04},
            **changes,
        }
    )


def test_joint_documents_have_their_own_curve_in_place_of_type_b():
    grid = {"elevation_deg": [-60.0, 0.0, 60.0], "std_deg": [0.04, 0.0, 0.08]}
    application = applied(elevation_std_deg=grid)
    expected = np.hypot(0.03, [0.04, 0.02, 0.0, 0.08])
    found = application.std_deg(np.array([-60.0, -30.0, 0.0, 60.0]))
    np.testing.assert_allclose(found, expected)
    level = applied(elevation_std_deg=grid, level_known=True, level_std_deg=0.4)
    np.testing.assert_allclose(level.std_deg(np.zeros(1)), np.hypot(0.03, 0.4))
    ignored = applied(elevation_std_deg=grid, level_known=False, level_std_deg=None)
    np.testing.assert_allclose(ignored.std_deg(np.zeros(1)), 0.03)


def test_beyond_the_range_the_elevation_is_given_and_its_worth_is_not_known():
    application = applied()
    elevation = application.elevation_deg(BIAS_DEG + SCALE * np.array([61.0, 61.5, -75.0]), None)
    np.testing.assert_allclose(elevation, [61.0, 61.5, -75.0])
    std = application.std_deg(elevation)
    assert std[0] == pytest.approx(0.05), "as good as at the end"
    assert np.isnan(std[1:]).all()
    np.testing.assert_allclose(application.beyond_range(elevation), [0.0, 1.5, 15.0])


def test_without_a_reference_nothing_is_claimed():
    assert np.isnan(applied(uncertainty={"type_a_deg": 0.03, "type_b_deg": None}).std_deg(np.zeros(3))).all()


def test_one_reading_that_stands_for_many_elevations_does_not_spoil_the_others():
    cubic = {"name": "nonlinearity", "parameters": {"deg_per_deg2": 0.0, "deg_per_deg3": -8e-5}}
    readings = np.array([0.0, 30.0, 150.0])
    found = applied(effects=[cubic], bias_deg=0.0, scale=1.0).elevation_deg(readings, None)
    assert np.isnan(found).tolist() == [False, False, True]
    np.testing.assert_allclose(found[:2] - 8e-5 * found[:2] ** 3, readings[:2], atol=1e-9)


def test_a_vector_is_corrected_by_the_matrix_or_by_effects_and_never_by_both():
    theta = np.linspace(-60.0, 60.0, 25)
    true = np.stack([np.full_like(theta, 0.1), *(f(np.radians(theta)) for f in (np.sin, np.cos))], axis=1)
    bias, matrix = [0.012, -0.03, 0.05], [[0.991, 0.004, -0.003], [0.0, 1.013, 0.006], [0.0, 0.0, 0.984]]
    raw = true @ np.linalg.inv(matrix).T + bias
    whole = applied(bias_deg=0.0, scale=1.0, accelerometer={"bias_g": bias, "matrix": matrix})
    found = whole.elevation_deg(whole.reading_of_deg(raw), None)
    np.testing.assert_allclose(found, theta, atol=1e-9)
    offset = ("accelerometer_offset", {"y_mg": 12.0, "z_mg": -25.0})
    both = applied(
        bias_deg=0.0,
        scale=1.0,
        accelerometer={"bias_g": bias, "matrix": matrix},
        effects=[{"name": offset[0], "parameters": offset[1]}],
    )
    reading = theta + effects_on_reading_deg([offset], theta, Circumstances())
    vectors = np.stack([np.zeros_like(theta), *(f(np.radians(reading)) for f in (np.sin, np.cos))], axis=1)
    np.testing.assert_allclose(both.elevation_deg(both.reading_of_deg(vectors), None), theta, atol=1e-9)
