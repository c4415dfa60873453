"""A mount that drifts slowly, of poses without an accelerometer: a drift in time, no mismatch of axes."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.regression.effect import ApplyError, Circumstances
from calrig.calibration.results.correction import effects_on_reading_deg, numbers_of

NOISE_DEG = 0.01
OF_THE_AXES = {"axis_mismatch", "accelerometer_offset"}


def found_in(poses):
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])


def drifted(time_s):
    """A slow curve within half an hour, that comes back: no mount creeps so."""
    u = time_s / 1800.0
    return 0.5 * u - 0.8 * u**2 + 0.3 * u**3


def drifting(target_deg, seed=0, **columns):
    time_s = 30.0 * np.arange(len(target_deg))
    noise_deg = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(time_s))
    reading_deg = 0.2 + target_deg + drifted(time_s) + noise_deg
    return posed(target_deg=target_deg, reading_deg=reading_deg, time_s=time_s, **columns)


def test_a_drift_while_the_targets_go_once_along_the_range_is_called_one_with_its_rivals():
    found = found_in(drifting(np.linspace(-40.0, 40.0, 60)))
    (effect,) = found["effects"]
    assert (effect["name"], effect["verdict"]) == ("time_drift", "ambiguous")
    assert "nonlinearity" in effect["confusable_with"]
    assert not OF_THE_AXES & {name["name"] for name in effect["considered"]}
    assert effect["parameters"]["deg_per_s"] is None
    assert found["final"]["fit_rms_deg"] <= 1.2 * NOISE_DEG


def test_a_rival_that_fits_far_worse_is_not_called_indistinguishable():
    (effect,) = found_in(drifting(np.linspace(-150.0, 150.0, 60)))["effects"]
    assert effect["confusable_with"] == ["stage_eccentricity"]
    (rival,) = (one for one in effect["considered"] if one["name"] == "stage_eccentricity")
    assert rival["behind"] > 10.0
    assert rival["why"] == "explains these poses worse, but poses taken like these cannot rule it out"


def test_a_curved_drift_of_targets_in_random_order_is_named_with_its_coefficients():
    target_deg = np.random.default_rng(5).permutation(np.linspace(-40.0, 40.0, 60))
    poses = drifting(target_deg)
    (effect,) = found_in(poses)["effects"]
    assert (effect["name"], effect["verdict"]) == ("time_drift", "named")
    time_s = np.array([pose.time_s for pose in poses])
    numbers = numbers_of(effect["parameters"])
    added_deg = effects_on_reading_deg([("time_drift", numbers)], target_deg, Circumstances(time_s=time_s))
    off_deg = added_deg - drifted(time_s)
    assert np.std(off_deg) <= NOISE_DEG


def test_a_drift_without_coefficients_is_not_applied():
    with pytest.raises(ApplyError):
        effects_on_reading_deg([("time_drift", {"size_deg": 0.1})], np.zeros(2), Circumstances())


@pytest.mark.parametrize(
    ("arc_deg", "accelerometer", "offered"), [(120, False, 0), (120, True, 1), (350, False, 1)]
)
def test_errors_of_the_axes_are_considered_with_an_accelerometer_or_over_a_full_turn(
    arc_deg, accelerometer, offered
):
    theta_deg = np.linspace(-arc_deg / 2, arc_deg / 2, 60)
    rng = np.random.default_rng(2)
    error_deg = 0.5 * np.sin(2.0 * np.radians(theta_deg))
    noise_deg, noise_g = rng.normal(0.0, NOISE_DEG, 60), rng.normal(0.0, 1e-4, (2, 60))
    felt = np.radians(theta_deg + error_deg)
    columns = {}
    if accelerometer:
        columns = {"accel_y_g": np.sin(felt) + noise_g[0], "accel_z_g": np.cos(felt) + noise_g[1]}
    poses = posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg + noise_deg, **columns)
    considered = {one["name"] for effect in found_in(poses)["effects"] for one in effect["considered"]}
    assert considered
    assert bool(OF_THE_AXES & considered) == bool(offered)


@pytest.mark.parametrize("seed", range(3))
def test_a_warm_up_and_a_curve_of_the_angle_do_not_hide_each_other(seed):
    """One stroke each way: each alone leaves the other, which looks like slow noise."""
    rng = np.random.default_rng(seed)
    up_deg = np.arange(-60.0, 61.0, 4.0)
    theta_deg = np.append(up_deg, up_deg[::-1])
    time_s = 12.0 * np.arange(len(theta_deg))
    warmer_c = 12.0 * (1.0 - np.exp(-time_s / 400.0))
    error_deg = 0.025 * warmer_c + 0.15 * np.sin(np.radians(2.0 * theta_deg))
    run = posed(
        target_deg=theta_deg,
        reading_deg=theta_deg + error_deg + rng.normal(0.0, 0.02, len(theta_deg)),
        time_s=time_s,
        temperature_c=np.round(22.0 + warmer_c, 1),
    )
    found = found_in(run)
    followed = {effect["covariate"] for effect in found["effects"]}
    assert "target_deg" in followed
    assert followed & {"temperature_c", "time_s"}
    assert found["final"]["fit_rms_deg"] < 0.025


def test_a_slip_between_two_equal_passes_is_told_from_no_drift():
    """With the scale free, a step between the passes is a drift to the last digit."""
    theta_deg = np.tile(np.arange(0.0, 201.0, 8.0), 2)
    time_s = 8.0 * np.arange(len(theta_deg))
    slipped_deg = 0.35 * (np.arange(len(theta_deg)) >= len(theta_deg) // 2)
    noise_deg = np.random.default_rng(1).normal(0.0, 0.02, len(theta_deg))
    run = posed(target_deg=theta_deg, reading_deg=theta_deg + slipped_deg + noise_deg, time_s=time_s)
    (effect,) = found_in(run)["effects"]
    assert effect["verdict"] == "ambiguous"
    assert {effect["name"], *effect["confusable_with"]} >= {"time_drift", "mount_slip"}
