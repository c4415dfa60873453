"""Uncertainty of a calibrated reading: type A by simulation, type B as the reference states it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calrig.calibration.fit import fit_line
from calrig.calibration.uncertainty import uncertainty


def test_type_a_is_the_error_of_new_readings_under_new_calibrations():
    """4000 calibrations of 6 poses, each applied to one new reading anywhere in the range."""
    rng = np.random.default_rng(0)
    theta_deg = np.array([-20.0, -5.0, 10.0, 25.0, 40.0, 60.0])
    squared_error, squared_stated = [], []
    for _ in range(4000):
        line = fit_line(theta_deg, 0.4 + 0.8 * theta_deg + rng.normal(0.0, 0.1, 6))
        new_deg = rng.uniform(-20.0, 60.0)
        reading_deg = 0.4 + 0.8 * new_deg + rng.normal(0.0, 0.1)
        squared_error.append(((reading_deg - line.bias_deg) / line.scale - new_deg) ** 2)
        squared_stated.append(uncertainty(line, (-20.0, 60.0), None).type_a_deg ** 2)

    assert math.sqrt(np.mean(squared_stated)) == pytest.approx(math.sqrt(np.mean(squared_error)), rel=0.04)


def test_no_number_of_poses_shrinks_the_references_share():
    rng = np.random.default_rng(1)
    theta_deg = np.tile(np.arange(-60.0, 61.0, 10.0), 200)
    line = fit_line(theta_deg, theta_deg + rng.normal(0.0, 0.01, len(theta_deg)))

    worth = uncertainty(line, (-60.0, 60.0), 0.29)

    assert worth.type_b_deg == worth.reference_deg == 0.29
    assert worth.expanded_deg == pytest.approx(2.0 * math.hypot(0.29, 0.01), rel=0.01)
    assert worth.to_dict() == {
        "type_a_deg": worth.type_a_deg,
        "type_b_deg": 0.29,
        "reference_deg": 0.29,
    }


def test_without_a_stated_reference_the_expanded_uncertainty_is_unknown():
    line = fit_line(np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.1, 20.0]))

    worth = uncertainty(line, (0.0, 20.0), None)

    assert worth.type_a_deg is not None
    assert (worth.type_b_deg, worth.reference_deg, worth.expanded_deg) == (None, None, None)


@pytest.mark.parametrize(
    ("theta_deg", "reading_deg"),
    [([0.0, 10.0], [0.0, 10.1]), ([5.0] * 4, [5.1, 5.2, 5.0, 5.1]), ([0.0, 1.0, 2.0], [3.0, 3.0, 3.0])],
)
def test_too_little_to_tell_scatter_or_scale_leaves_type_a_unknown(theta_deg, reading_deg):
    worth = uncertainty(fit_line(np.array(theta_deg), np.array(reading_deg)), (0.0, 10.0), 0.29)

    assert (worth.type_a_deg, worth.expanded_deg) == (None, None)
    assert worth.type_b_deg == 0.29
