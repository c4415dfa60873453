"""Verdict of a verification: noise and stated uncertainty pass, a fault fails, outside nothing is judged."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.results import Promise, basis_of_poses, build_result, verify
from calrig.calibration.uncertainty.verdict import make_verdict
from calrig.model.result import Reference
from calrig.model.verdict import Limit
from tests.studies.verifications import counted

NOISE_DEG = 0.02
UP = np.arange(-60.0, 61.0, 10.0)


def poses(n, seed, *, shape_deg=0.0, temperature_c=25.0, warm_deg_per_c=0.0, reach=1.0):
    theta = reach * np.resize([*UP, *UP[::-1]], n)
    warmth = temperature_c + np.sin(np.arange(n))
    reading = 0.8 + 1.002 * theta + np.random.default_rng(seed).normal(0.0, NOISE_DEG, n)
    reading += shape_deg * np.sin(np.pi * theta / 60.0) + warm_deg_per_c * (warmth - 25.0)
    return posed(target_deg=theta, reading_deg=reading, temperature_c=warmth, reading_stderr_deg=NOISE_DEG)


def verified(n=52, effects=(), reference=None, calibrated=52, **fresh):
    given = poses(calibrated, 1)
    calibration = build_result(given, None, effects, reference)
    line = calibration.line_with_effects or calibration.line
    basis = basis_of_poses([given], line, effects, NOISE_DEG)
    promise = Promise((-60.0, 60.0), (24.0, 26.0), basis)
    return verify(poses(n, 2, **fresh), None, line, effects, calibration.reference, promise)


def judged(result, **more):
    return make_verdict(result, verification=True, **more)


@pytest.mark.parametrize(("calibrated", "n"), [(52, 52), (18, 52), (52, 26)])
def test_noise_alone_is_noise_and_a_fault_of_three_noises_is_more(calibrated, n):
    assert judged(verified(n, calibrated=calibrated)).left == "noise"
    faulty = judged(verified(n, calibrated=calibrated, shape_deg=3.0 * NOISE_DEG))
    assert faulty.left == "more_than_noise"
    assert faulty.ratio > 1.5


def test_the_uncertainty_of_a_temperature_coefficient_counts_where_the_verification_is_warm():
    effects = [("temperature_bias", {"deg_per_c": 0.0, "reference_c": 25.0})]
    bare, with_it = verified(temperature_c=26.0), verified(effects=effects, temperature_c=26.0)
    assert with_it.verified.ratio < bare.verified.ratio


@pytest.mark.parametrize("fresh", [{"temperature_c": 37.0}, {"reach": 2.0}])
def test_outside_the_calibrated_range_it_is_said_first_with_both_ranges_and_nothing_fails(fresh):
    result = verified(**fresh, shape_deg=3.0)
    one = judged(result, limit=Limit(name="flight", max_error_deg=0.1))
    assert one.says[0].startswith("Outside the calibrated range")
    assert "24.0 °C to 26.0 °C" in one.says[0]
    assert "−60.0° to 60.0°" in one.says[0]
    if "temperature_c" in fresh:
        assert (one.left, one.ratio, one.answer, result.verified.n_tested) == (None, None, "undecided", 0)
        assert not any("cause" in said for said in one.says)
    else:  # what lies inside is judged, and has a fault
        assert (one.left, one.answer) == ("more_than_noise", "fail")
        assert 0 < result.verified.n_tested < 52


def test_poses_beyond_the_range_spoil_no_verdict_on_those_inside():
    result = verified(reach=2.0)
    assert result.verified.n_outside > 0
    assert judged(result).left == "noise"


def test_an_error_of_the_same_stage_that_its_certificate_covers_is_no_change():
    loose = verified(reference=Reference(5.0, "harmonic"), shape_deg=0.0)
    assert judged(loose).left == "noise"
    assert judged(verified(reference=Reference(0.001, "common"), shape_deg=0.1)).left == "more_than_noise"


def test_a_result_is_stored_with_its_test_and_read_again():
    result = verified()
    kept = type(result).__mro__[1].model_validate(result.to_dict())
    assert kept.verified == result.verified
    assert "verified" not in build_result(poses(52, 1)).to_dict()


@pytest.mark.statistical
def test_a_study_drawn_by_numpy_alone_finds_faults_and_accuses_less_than_the_test_before():
    clear = [counted(26, 52, rho, warm=True, runs=12) for rho in (0.0, 0.6)]
    assert sum(one.alarms for one in clear) <= 2
    assert sum(one.alarms_before for one in clear) > sum(one.alarms for one in clear)
    assert sum(one.found for one in clear) >= 20


@pytest.mark.parametrize("others", [0, 1])
def test_an_error_of_the_rig_beside_takes_no_column_of_the_calibrations_basis(others):
    given, of_rig = poses(52, 1), [("temperature_bias", {"deg_per_c": 0.0, "reference_c": 25.0})]
    calibration = build_result(given, None, of_rig)
    runs = [given, *(poses(52, 10 + k) for k in range(others))]
    basis = basis_of_poses(runs, calibration.line, [], NOISE_DEG, of_rig=of_rig)
    promise = Promise((-60.0, 60.0), (24.0, 26.0), basis)
    with_it, without = (
        verify(poses(52, 2), None, calibration.line, some, None, promise).verified for some in (of_rig, [])
    )
    assert with_it.ratio == pytest.approx(without.ratio, rel=1e-6)


def test_exact_poses_of_a_calibration_say_nothing_of_a_correlation():
    theta = np.resize([*UP, *UP[::-1]], 52)
    exact = posed(target_deg=theta, reading_deg=1.0 + theta, reading_stderr_deg=0.0)
    line = build_result(exact).line
    promise = Promise((-60.0, 60.0), None, basis_of_poses([exact], line, [], 0.0))
    noise = np.random.default_rng(2).normal(0.0, NOISE_DEG, 52)
    fresh = posed(target_deg=theta, reading_deg=1.0 + theta + noise, reading_stderr_deg=NOISE_DEG)
    result = verify(fresh, None, line, [], None, promise)
    assert judged(result).left == "noise"
    assert result.verified.against_calibration_p is None


def test_a_long_calibration_is_verified_without_a_matrix_of_all_its_poses():
    n = 20_000
    given = poses(n, 1)
    line = build_result(given).line
    promise = Promise((-60.0, 60.0), (24.0, 26.0), basis_of_poses([given], line, [], NOISE_DEG))
    assert judged(verify(poses(52, 2), None, line, [], None, promise)).left == "noise"
