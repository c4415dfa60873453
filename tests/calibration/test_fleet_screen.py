"""The screen of a fleet: what it says of each run is what least squares say of that run alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calrig.calibration.fleet_screen import OF_RUNS, screen
from calrig.calibration.line import fit_line, residuals_deg, rms
from calrig.calibration.packed_poses import packed
from calrig.calibration.poses import Pose


def run(seed: int, n: int = 40, noise_deg: float = 0.03, **effects: float) -> list[Pose]:
    """A run there and back over ±60°, in noise, with a bias of 0.8° and a scale of 1.002."""
    rng = np.random.default_rng(seed)
    theta = np.linspace(-60.0, 60.0, n // 2)
    theta = np.concatenate([theta, theta[::-1]])
    approach = np.repeat([1, -1], n // 2)
    warm = 4.0 * (1.0 - np.exp(-np.arange(n) / 12.0)) + rng.normal(0.0, 0.02, n)
    reading = 0.8 + 1.002 * theta + rng.normal(0.0, noise_deg, n)
    reading += effects.get("backlash_deg", 0.0) / 2.0 * approach + effects.get("deg_per_c", 0.0) * warm
    tilt = np.radians(reading - 0.8)
    g = 1.0 + rng.normal(0.0, 3e-4, n) + effects.get("z_mg", 0.0) * 1e-3 * np.cos(tilt)
    return [
        Pose(
            target_deg=float(theta[k]),
            reading_deg=float(reading[k]),
            approach=int(approach[k]),
            time_s=5.0 * k,
            temperature_c=20.0 + float(warm[k]),
            accel_y_g=float(g[k] * math.sin(tilt[k])),
            accel_z_g=float(g[k] * math.cos(tilt[k])),
            covariates={"humidity": float(rng.normal())},
        )
        for k in range(n)
    ]


def share_along(poses: list[Pose], column: np.ndarray) -> float:
    """Oracle: R² of a column beside bias and scale, of the poses after the first, by lstsq."""
    theta = np.array([pose.theta_deg for pose in poses])
    reading = np.array([pose.reading_deg for pose in poses]) - theta
    base = np.column_stack([np.ones_like(theta), theta])[1:]

    def left(design: np.ndarray) -> float:
        off = reading[1:] - design @ np.linalg.lstsq(design, reading[1:], rcond=None)[0]
        return float(off @ off)

    return 1.0 - left(np.column_stack([base, column[1:]])) / left(base)


RAGGED = {f"run-{n}": run(n, n=n, backlash_deg=0.02, deg_per_c=0.005) for n in (12, 40, 26, 40, 100, 66)}


def test_each_run_of_many_is_fitted_as_by_itself():
    seen = screen(packed(RAGGED))
    first = 0
    for k, poses in enumerate(RAGGED.values()):
        theta = np.array([pose.theta_deg for pose in poses])
        reading = np.array([pose.reading_deg for pose in poses])
        line = fit_line(theta, reading)
        left = residuals_deg(theta, reading, line.bias_deg, line.scale)
        assert seen.bias_deg[k] == pytest.approx(line.bias_deg, abs=1e-9)
        assert seen.scale[k] == pytest.approx(line.scale, abs=1e-12)
        assert seen.rms_deg[k] == pytest.approx(rms(left) * line.scale, rel=1e-9)
        assert seen.residual_deg[first : first + len(poses)] == pytest.approx(left, abs=1e-9)
        first += len(poses)


def test_shares_are_those_of_least_squares():
    seen = screen(packed(RAGGED))
    for k, poses in enumerate(RAGGED.values()):
        approach = np.array([pose.approach for pose in poses], dtype=float)
        humidity = np.array([pose.covariates["humidity"] for pose in poses])
        assert seen.direction[k] == pytest.approx(share_along(poses, approach), abs=2e-5)
        assert seen.covariate[k] == pytest.approx(share_along(poses, humidity), abs=2e-5)


def test_a_run_says_the_same_in_whatever_company():
    together = screen(packed(RAGGED))
    for k, (name, poses) in enumerate(RAGGED.items()):
        alone = screen(packed({name: poses}))
        for field in OF_RUNS:
            assert getattr(together, field)[k] == pytest.approx(getattr(alone, field)[0], rel=1e-4), field


def test_a_share_of_noise_is_distributed_as_it_should_be():
    seen = screen(packed({str(seed): run(seed) for seed in range(400)}))
    freedom = 40 - 1 - 2
    expected = stats.beta(0.5, (freedom - 1) / 2.0)
    assert stats.kstest(seen.direction, expected.cdf).pvalue > 0.01
    assert stats.kstest(seen.covariate, expected.cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("kind", "effect"),
    [("direction", {"backlash_deg": 0.08}), ("temperature", {"deg_per_c": 0.03}), ("gravity", {"z_mg": 1.5})],
)
def test_an_effect_stands_out_by_its_own_kind(kind, effect):
    seen = screen(packed({"none": run(1), "effect": run(1, **effect)}))
    assert seen.stands_out.tolist() == [False, True]
    assert getattr(seen, kind)[1] > 0.4 > getattr(seen, kind)[0]


def test_the_direction_is_told_in_degrees():
    seen = screen(packed({"r": run(1, n=400, backlash_deg=0.08)}))
    assert seen.direction_deg[0] == pytest.approx(0.08, abs=0.01)


@pytest.mark.parametrize("wild", [0, 17])
def test_a_pose_gone_wrong_neither_makes_an_effect_nor_hides_one(wild):
    def spoilt(poses: list[Pose]) -> list[Pose]:
        wrong = replace(poses[wild], reading_deg=poses[wild].reading_deg + 5.0)
        return [*poses[:wild], wrong, *poses[wild + 1 :]]

    seen = screen(packed({"noise": spoilt(run(1)), "effect": spoilt(run(1, backlash_deg=0.12))}))
    assert seen.stands_out.tolist() == [False, True]


def test_what_is_not_known_is_not_judged():
    bare = [replace(pose, temperature_c=None, accel_y_g=None, time_s=None, covariates={}) for pose in run(1)]
    seen = screen(packed({"bare": bare, "whole": run(2), "few": run(3)[:7]}))
    assert seen.temperature[0] == 0.0
    assert seen.gravity[0] == 0.0
    assert not seen.stands_out.any()
    assert np.isnan(seen.p_value[2])
    assert seen.rms_deg[2] > 0.0  # a line goes through any


def test_one_elevation_has_no_scale_and_arithmetic_no_effect():
    reading_deg = [10.3 + 0.01 * (k % 3) for k in range(40)]
    still = [replace(p, target_deg=10.0, reading_deg=r) for p, r in zip(run(1), reading_deg, strict=True)]
    exact = [replace(pose, reading_deg=0.5 + 1.1 * pose.target_deg, accel_y_g=None) for pose in run(2)]
    seen = screen(packed({"still": still, "exact": exact}))
    assert np.isnan(seen.scale[0])
    assert seen.scale[1] == pytest.approx(1.1)
    assert not seen.stands_out[1]


def test_a_reading_of_noise_alone_has_no_error_in_degrees():
    rng = np.random.default_rng(7)
    stuck = [replace(pose, reading_deg=5.0 + float(rng.normal(0.0, 0.02))) for pose in run(1)]
    seen = screen(packed({"stuck": stuck, "sound": run(1)}))
    assert np.isnan(seen.residual_deg[:40]).all()
    assert np.isfinite(seen.residual_deg[40:]).all()


def test_a_unit_upside_down_is_fitted_on_its_own_turn():
    turned = [replace(pose, reading_deg=(pose.reading_deg + 360.0) % 360.0 - 180.0) for pose in run(1)]
    seen = screen(packed({"as it is": run(1), "turned": turned}))
    assert seen.rms_deg[1] == pytest.approx(seen.rms_deg[0])


def test_no_runs_are_no_trouble():
    assert len(screen(packed({"none": run(1)}).runs(np.empty(0, dtype=np.intp))).p_value) == 0
