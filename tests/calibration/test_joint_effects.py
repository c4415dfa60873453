"""Effects fitted over several runs, and poses once effects are taken out of them: numpy knows the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posed import posed
from studies.accepting import EFFECTS, FIRST_C, SECOND_C, measured

from calrig.calibration.diagnosis.joint_effects import RunOfEffects, fit_together, held_out_growth
from calrig.calibration.poses import DiagnosisError, Pose
from calrig.calibration.results import EffectDoubt, build_result, own_effect, poses_without_effects

BACKLASH_DEG = 0.2
WORN = {
    "name": "backlash",
    "covariate": "approach",
    "parameters": {"backlash_deg": {"value": 0.2, "std": 0.01}},
    "changed": None,
}
NAMELESS = {
    "name": "unnamed",
    "covariate": "time_s",
    "parameters": {"size_deg": {"value": 0.1, "std": None}, "period": None, "at": None},
    "changed": None,
}


def worn(poses: list[Pose]) -> list[Pose]:
    """The poses on a stage with backlash, which turns reading and accelerometer."""
    found = []
    for pose in poses:
        sense = 1 if (pose.sweep or 0) % 2 == 0 else -1
        turn = np.radians(sense * BACKLASH_DEG / 2)
        y, z = pose.accel_y_g or 0.0, pose.accel_z_g or 0.0
        found.append(
            replace(
                pose,
                approach=sense,
                reading_deg=pose.reading_deg + sense * BACKLASH_DEG / 2,
                accel_y_g=float(y * np.cos(turn) + z * np.sin(turn)),
                accel_z_g=float(z * np.cos(turn) - y * np.sin(turn)),
            )
        )
    return found


def test_what_else_a_run_shows_is_fitted_in_it_alone_and_not_taken_up():
    rng = np.random.default_rng(0)
    first, second = worn(measured(rng, FIRST_C)), measured(rng, SECOND_C)
    runs = [RunOfEffects("1", first, [WORN, NAMELESS]), RunOfEffects("2", second, [NAMELESS])]
    found = dict(fit_together(runs, EFFECTS).effects)
    for name, parameter, true in (
        ("accelerometer_offset", "y_mg", 14.0),
        ("accelerometer_offset", "z_mg", -18.0),
        ("temperature_bias", "deg_per_c", 0.012),
    ):
        one = found[name][parameter]
        assert one["value"] == pytest.approx(true, abs=3.5 * one["std"])


def test_what_was_taken_out_of_a_run_does_not_enter_the_effects_that_are_left():
    poses = measured(np.random.default_rng(4), SECOND_C)
    taken_out = {"name": "accelerometer_offset", "parameters": {"y_mg": 14.0, "z_mg": -18.0}}
    found = dict(fit_together([RunOfEffects("2", poses, [taken_out])], EFFECTS[1:]).effects)
    one = found["temperature_bias"]["deg_per_c"]
    assert one["value"] == pytest.approx(0.012, abs=3.5 * one["std"])
    assert one["std"] < 0.002


def test_orders_of_an_encoder_accepted_from_two_runs_are_in_one_model_each_once():
    """With a good reference they are the unit's; 180° was accepted from both runs, as 180.2° from one."""
    rng = np.random.default_rng(9)
    amplitudes_deg = {180.0: 0.8, 90.0: 0.4, 45.0: 0.2}
    theta = rng.uniform(0.0, 360.0, 160)
    error = sum(a * np.sin(np.radians(theta * 360.0 / p) + 0.4) for p, a in amplitudes_deg.items())
    reading = theta + 0.3 + error + 0.02 * rng.standard_normal(160)
    poses = [Pose(*map(float, row)) for row in zip(theta, reading, strict=True)]
    accepted = [
        own_effect("stage_periodic", {"amplitude_deg": 0.5, "period_deg": period, "phase_deg": 10.0})
        for period in (180.0, 90.0, 180.2, 45.0)
    ]
    found = fit_together([RunOfEffects("1", poses[:80]), RunOfEffects("2", poses[80:])], accepted)
    assert [name for name, _ in found.effects] == ["stage_periodic"] * 3
    sizes_deg = {
        values["period_deg"]["value"]: values["amplitude_deg"]["value"] for _, values in found.effects
    }
    assert sizes_deg == pytest.approx(amplitudes_deg, abs=0.02)
    left = poses_without_effects(poses, found.applied)
    assert np.std([pose.reading_deg - pose.target_deg for pose in left]) < 0.03


def test_levels_of_runs_that_differ_are_their_standard_deviation():
    rng = np.random.default_rng(1)
    runs = [
        RunOfEffects(str(k), measured(rng, ends_c, at))
        for k, (ends_c, at) in enumerate(zip([FIRST_C, SECOND_C, FIRST_C], [0.0, 0.5, -0.5], strict=True))
    ]
    assert fit_together(runs, EFFECTS).run_offset_std_deg == pytest.approx(0.5, rel=0.05)
    assert fit_together(runs[:1], EFFECTS).run_offset_std_deg is None


def test_an_effect_that_the_poses_cannot_show_is_named():
    rng = np.random.default_rng(2)
    cold = [replace(pose, temperature_c=None) for pose in measured(rng, FIRST_C)]
    with pytest.raises(DiagnosisError, match=r"run 1 and 2 .*temperature_bias"):
        fit_together([RunOfEffects("1", cold), RunOfEffects("2", measured(rng, SECOND_C))], EFFECTS)


def test_a_run_that_another_contradicts_is_predicted_worse():
    rng = np.random.default_rng(3)
    first, second = measured(rng, FIRST_C), measured(rng, SECOND_C)
    mirrored = [replace(pose, temperature_c=77.0 - (pose.temperature_c or 0.0)) for pose in second]
    as_it_is, contradicted = (
        held_out_growth([RunOfEffects("1", first), RunOfEffects("2", one)], EFFECTS, 1, EFFECTS)
        for one in (second, mirrored)
    )
    assert not any(one.is_too_large for one in as_it_is)
    assert contradicted[0].is_too_large


def test_poses_without_their_effects_are_those_of_a_faultless_unit():
    theta = np.linspace(-50.0, 60.0, 23)
    celsius = np.linspace(20.0, 30.0, 23)
    bias, scale, square = 0.3, 1.001, 2e-4
    felt = bias + scale * theta
    s, c = np.sin(np.radians(felt)), np.cos(np.radians(felt))
    warm_deg, bent_deg = 0.02 * (celsius - 25.0), square * theta**2
    offset_g = (12e-3, -20e-3)
    turn = np.radians(warm_deg)
    y, z = s * np.cos(turn) + c * np.sin(turn), c * np.cos(turn) - s * np.sin(turn)
    y, z = y + offset_g[0] + np.radians(bent_deg) / c, z + offset_g[1]
    of_offset_deg = np.degrees(
        np.arctan2(offset_g[0] * c - offset_g[1] * s, 1 + offset_g[0] * s + offset_g[1] * c)
    )
    reading = felt + of_offset_deg + warm_deg + bent_deg
    poses = [
        Pose(
            *map(float, row[:2]),
            temperature_c=float(row[2]),
            accel_y_g=float(row[3]),
            accel_z_g=float(row[4]),
        )
        for row in zip(theta, reading, celsius, y, z, strict=True)
    ]
    effects = [
        ("accelerometer_offset", {"y_mg": 12.0, "z_mg": -20.0}),
        ("temperature_bias", {"deg_per_c": 0.02, "reference_c": 25.0}),
        ("nonlinearity", {"deg_per_deg2": square}),
    ]
    left = poses_without_effects(poses, effects)
    np.testing.assert_allclose([pose.reading_deg for pose in left], felt, atol=1e-6)
    np.testing.assert_allclose(
        [[pose.accel_y_g, pose.accel_z_g] for pose in left], np.column_stack([s, c]), atol=4e-4
    )


def test_the_doubt_of_an_effect_does_not_wrap_with_the_bias_of_a_unit_upside_down():
    theta = np.resize(np.arange(-60.0, 61.0, 10.0), 26)
    stds = []
    for bias_deg in (1.0, 179.999):
        given = posed(
            target_deg=theta,
            reading_deg=bias_deg + theta + 0.01 * np.sin(7.0 * np.arange(26)),
            temperature_c=25.0 + np.sin(np.arange(26)),
        )
        warmth = [("temperature_bias", {"deg_per_c": 0.0, "reference_c": 15.0})]
        result = build_result(given, None, warmth, doubt=EffectDoubt([{"deg_per_c": 0.001}]))
        stds.append(result.line_with_effects.bias_std_deg)
    assert stds[1] == pytest.approx(stds[0], rel=1e-6)


def test_a_line_less_fitted_effects_has_the_covariance_of_one_fit_of_all_parameters():
    """Time and temperature rise together, so that the errors of both terms are correlated by −0.99."""
    rng = np.random.default_rng(12)
    theta = np.tile(np.linspace(-60.0, 60.0, 13), 8)
    n = np.arange(len(theta))
    celsius = 20.0 + 0.1 * n + 0.3 * rng.standard_normal(len(n))
    reading = 0.4 + 1.002 * theta + 0.012 * (celsius - 20.0) + 0.01 * rng.standard_normal(len(n))
    columns = np.column_stack([np.ones(len(n)), theta, celsius - 20.0, 5.0 * n])
    coefficients = np.linalg.lstsq(columns, reading, rcond=None)[0]
    covariance = np.linalg.inv(columns.T @ columns) * 0.01**2
    effects = [
        ("temperature_bias", {"deg_per_c": coefficients[2], "reference_c": 20.0}),
        ("time_drift", {"deg_per_s": coefficients[3]}),
    ]
    poses = [
        Pose(*map(float, row[:2]), temperature_c=float(row[2]), time_s=float(row[3]))
        for row in zip(theta, reading, celsius, 5.0 * n, strict=True)
    ]
    factor = np.linalg.cholesky(covariance[2:, 2:])
    stds = np.sqrt(np.diag(covariance))[2:]
    names = ["deg_per_c", "deg_per_s"]
    together = EffectDoubt(
        [{name: std} for name, std in zip(names, stds.tolist(), strict=True)],
        factors=[{name: row} for name, row in zip(names, factor.tolist(), strict=True)],
    )
    bare, with_both, alone = (
        build_result(poses, effects=effects, doubt=doubt).line_with_effects.covariance[0][0]
        for doubt in (None, together, EffectDoubt(together.stds))
    )
    own = float(np.linalg.inv(columns[:, :2].T @ columns[:, :2])[0, 0]) * 0.01**2
    assert with_both - bare == pytest.approx(covariance[0, 0] - own, rel=1e-6)
    assert alone - bare > 5.0 * (with_both - bare)
