"""Partial residuals: one effect alone, everything else taken out, as the diagnosis states it."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.report import partial_residuals
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import DiagnosisError

NOISE_DEG = 0.02


def measured(added, n=96, seed=3):
    """Poses in random order with a temperature and a supply that wander apart, and what `added` says."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-60, 60, n)
    approach = np.sign(np.diff(theta, prepend=-90.0))
    temperature_c = 30 + 4 * np.sin(np.arange(n) / 15)
    supply_v = 3.3 + 0.25 * rng.choice([-1, 1], n) * rng.uniform(0.5, 1, n)
    readings = (
        0.8 + 1.002 * theta + added(approach, temperature_c, supply_v) + NOISE_DEG * rng.standard_normal(n)
    )
    known = {"approach": approach, "temperature_c": temperature_c, "supply_v": supply_v}
    return posed(target_deg=theta, reading_deg=readings, time_s=3.0 * np.arange(n), **known)


def found_in(poses):
    """The effects of a diagnosis by name, each with its partial residual."""
    effects = document(diagnose([poses], cross_fit=False), ["1"])["effects"]
    return {
        e["name"]: (e["parameters"], t)
        for e, t in zip(effects, partial_residuals([poses], effects), strict=True)
    }


def test_each_effect_stands_alone_and_as_large_as_the_diagnosis_says():
    poses = measured(lambda approach, temperature_c, _: -0.06 * approach + 0.02 * (temperature_c - 30))
    found = found_in(poses)
    assert set(found) == {"backlash", "temperature_bias"}
    parameters, backlash = found["backlash"]
    assert np.ptp(backlash.effect_deg) == pytest.approx(abs(parameters["backlash_deg"]["value"]), rel=1e-6)
    np.testing.assert_array_equal(backlash.at, [pose.approach for pose in poses])
    parameters, temperature = found["temperature_bias"]
    slope = np.polyfit(temperature.at, temperature.effect_deg, 1)[0]
    assert slope == pytest.approx(parameters["deg_per_c"]["value"], rel=1e-6)
    for _, one in found.values():
        beside = one.residual_deg - one.effect_deg
        assert beside.std() == pytest.approx(NOISE_DEG, rel=0.25)


def test_a_shape_without_a_name_is_drawn_against_its_column_at_the_size_stated():
    poses = measured(lambda _approach, _temperature, supply_v: 0.4 * (supply_v - 3.3))
    parameters, shape = found_in(poses)["unnamed"]
    assert shape.covariate == "supply_v"
    assert np.ptp(shape.effect_deg) == pytest.approx(parameters["size_deg"]["value"], rel=1e-6)
    assert np.corrcoef(shape.at, shape.residual_deg)[0, 1] > 0.9


def test_an_effect_explains_the_share_of_the_residual_that_it_was_given():
    """Up and down ±0.12°, a temperature of ±5 °C at 0.008°/°C, noise of 0.02°: 144, 16 and 4 parts."""
    rng = np.random.default_rng(5)
    n = 96
    theta = np.repeat(np.linspace(-60, 60, n // 4), 4)
    approach, warm = np.tile([1, 1, -1, -1], n // 4), np.tile([1, -1, 1, -1], n // 4)
    noise = rng.permutation(np.tile([-1.0, 1.0], n // 2)) * NOISE_DEG
    poses = posed(
        target_deg=theta,
        reading_deg=0.8 + 1.002 * theta - 0.12 * approach + 0.04 * warm + noise,
        approach=approach,
        temperature_c=30.0 + 5.0 * warm,
    )
    effects = document(diagnose([poses], cross_fit=False), ["1"])["effects"]
    shares = {effect["name"]: effect["explained"] for effect in effects}
    assert shares == {
        "backlash": pytest.approx(144 / 164, abs=0.02),
        "temperature_bias": pytest.approx(16 / 164, abs=0.02),
    }


def test_shares_of_correlated_effects_and_of_the_final_residual_add_up_to_one():
    poses = measured(lambda a, temperature_c, _: -0.06 * a + 0.02 * (temperature_c - 30))
    diagnosed = diagnose([poses], cross_fit=False)
    found = document(diagnosed, ["1"])
    r = diagnosed.findings.responses
    shares = [effect["explained"] for effect in found["effects"]]
    before_deg = r.values[:, 0] - np.polyval(np.polyfit(r.theta_deg, r.values[:, 0], 1), r.theta_deg)
    after_deg = diagnosed.findings.fitted.residuals[:, 0]
    assert len(shares) == 2
    assert sum(shares) + before_deg @ after_deg / (before_deg @ before_deg) == pytest.approx(1.0, abs=1e-3)


def test_poses_that_cannot_show_the_effect_any_more_say_so():
    poses = measured(lambda approach, *_: -0.06 * approach)
    effects = document(diagnose([poses], cross_fit=False), ["1"])["effects"]
    upward = [pose for pose in poses if pose.approach == 1]
    with pytest.raises(DiagnosisError, match="backlash"):
        partial_residuals([upward], effects)
