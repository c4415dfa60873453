"""What a solution leaves behind: a calibration that flight software applies, and the stage's map."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from calrig.calibration.results.correction import Application, calibrated_elevation_deg, numbers_of
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.stage_map import basis
from calrig.export.formats.c_header import c_header
from calrig.export.solution_documents import joint_files, stage_map_document, unit_document

from .cases import BOUNDS, error_deg, solved
from .oracle import calibrated_error_deg

THREE = BOUNDS["0/120/240, ±60°, cubic"]


@pytest.fixture(scope="module")
def solution():
    return solved(THREE.bench(6), 6, linear=False)


def test_a_calibration_takes_out_what_the_unit_does(solution):
    worth = solution.uncertainties[0]
    error = error_deg(THREE.bench(6), solution)
    assert np.sqrt(np.mean(error**2)) < 2.5 * worth.rms_deg
    document = unit_document(solution, 0)
    assert document["uncertainty"]["reference_deg"] == worth.rms_deg, "in place of the stage's 0.29°"
    assert document["expanded_uncertainty_deg"] == pytest.approx(
        document["coverage_factor"] * np.hypot(solution.noise_deg, worth.rms_deg)
    )
    assert (document["level_known"], document["level_std_deg"]) == (False, None)
    assert {effect["name"] for effect in document["effects"]} == {
        "accelerometer_offset",
        "axis_mismatch",
        "axis_nonlinearity",
    }


def test_a_polynomial_of_the_angle_alone_would_cost_more_than_a_tenth_of_the_uncertainty(solution):
    (unit,) = solution_document(solution)["units"]
    exact = [(effect["name"], effect["parameters"]) for effect in unit_document(solution, 0)["effects"]]
    polynomial = {k: v for k, v in numbers_of(unit["parameters"]).items() if k.startswith("deg_per_deg")}
    projected = [*exact[:2], ("nonlinearity", polynomial)]

    def left(effects):
        bench = THREE.bench(6)
        return calibrated_error_deg(
            bench, 0, 25.0, lambda angle_deg: calibrated_elevation_deg(angle_deg, 0.0, 1.0, effects)
        )

    elevation = np.linspace(-60.0, 60.0, 121)
    apart = left(projected) - left(exact)
    apart -= np.polyval(np.polyfit(elevation, apart, 1), elevation)
    assert np.sqrt(np.mean(apart**2)) > 0.1 * solution.uncertainties[0].rms_deg


def test_the_files_are_hashed_and_make_a_header(solution):
    files = joint_files({"U0": unit_document(solution, 0)}, stage_map_document(solution))
    assert set(files) == {"U0.json", "stage-map.json"}
    for text in files.values():
        document = json.loads(text)
        stated = document.pop("sha256")
        plain = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        assert stated == hashlib.sha256(plain.encode()).hexdigest()
    assert "axis_nonlinearity" in c_header({"revision": 1, **json.loads(files["U0.json"])})


def test_applied_its_elevations_are_worth_what_it_says(solution):
    application = Application.of_document(unit_document(solution, 0))
    left = calibrated_error_deg(
        THREE.bench(6), 0, 25.0, lambda angle_deg: application.elevation_deg(angle_deg, None)
    )
    np.testing.assert_allclose(left, error_deg(THREE.bench(6), solution), atol=1e-9)
    worth = solution.uncertainties[0]
    std = application.std_deg(worth.elevation_deg)
    np.testing.assert_allclose(std, np.hypot(solution.noise_deg, worth.std_deg), rtol=1e-9)


def test_the_maps_series_is_the_map(solution):
    document = stage_map_document(solution)
    dial = np.array(document["map"]["stage_deg"])
    series = basis(dial, np.zeros(len(dial)), document["orders"]) @ document["coefficients_deg"]
    np.testing.assert_allclose(series - series.mean(), document["map"]["error_deg"], atol=1e-9)
    assert np.linalg.eigvalsh(document["covariance_deg2"])[0] > -1e-12
