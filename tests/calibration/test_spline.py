"""A natural cubic spline as a table of knots is the curve that was fitted by its basis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from calrig.calibration.regression.spline import NaturalSplines, SplineCurve, curve_document, natural_spline


def curve_of(document):
    return SplineCurve.of({name: one["value"] for name, one in document.items()})


@pytest.mark.parametrize("pieces", [3, 5, 33])
def test_the_document_has_the_curve_that_the_basis_gives_less_its_straight_line(pieces):
    rng = np.random.default_rng(pieces)
    theta_deg = rng.uniform(-75.0, 240.0, 400)
    columns, knots = natural_spline(theta_deg, pieces), NaturalSplines.over(theta_deg, pieces).at
    beta = rng.normal(size=columns.shape[1])
    fitted = columns @ beta
    bent = fitted - np.polyval(np.polyfit(theta_deg, fitted, 1), theta_deg)
    curve = curve_of(curve_document(knots, columns, beta, np.diag(np.full(len(beta), 1e-4))))
    size = np.ptp(fitted)
    np.testing.assert_allclose(curve(theta_deg), bent, atol=1e-9 * size)

    other = CubicSpline(curve.knots, curve.values, bc_type="natural")
    at = np.linspace(knots[0], knots[-1], 1001)
    np.testing.assert_allclose(curve(at), other(at), atol=1e-9 * size)
    outside = knots[-1] + np.array([10.0, 20.0])
    end = other(knots[-1]) + other(knots[-1], 1) * (outside - knots[-1])
    np.testing.assert_allclose(curve(outside), end, atol=1e-9 * size, err_msg="straight beyond its ends")


def test_the_standard_errors_at_the_knots_are_those_of_many_fits_beside_a_line():
    rng = np.random.default_rng(4)
    theta_deg, noise_deg = np.linspace(-60.0, 60.0, 120), 0.1
    columns, knots = natural_spline(theta_deg, 5), NaturalSplines.over(theta_deg, 5).at
    model = np.column_stack([np.ones(120), theta_deg, columns])  # singular: the line is in it twice
    solved = np.linalg.pinv(model)[2:]
    covariance = solved @ solved.T * noise_deg**2
    betas = (solved @ rng.normal(size=(120, 400)) * noise_deg).T
    documents = [curve_document(knots, columns, beta, covariance) for beta in betas]
    stated = [documents[0][f"curve_{k}_deg"]["std"] for k in range(6)]
    scatter = np.std([curve_of(document).values for document in documents], axis=0)
    np.testing.assert_allclose(scatter, stated, rtol=0.15)
    assert max(stated) < noise_deg, "the straight line, which nothing determines, is not in them"


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"size_deg": 0.3, "knot_0_deg": 0.0, "curve_0_deg": 1.0},
        {f"{name}_{k}_deg": 1.0 for k in range(4) for name in ("knot", "curve")},
    ],
)
def test_what_states_no_curve_is_none(parameters):
    assert SplineCurve.of(parameters) is None
