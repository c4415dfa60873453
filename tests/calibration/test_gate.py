"""The gate's likelihood ratios beside plain least squares, and what its verdict rests on."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.candidates import candidates_of
from calrig.calibration.gate import Screen, Verdict, gate
from calrig.calibration.noise_model import NoiseModel, fit
from calrig.calibration.pose import Pose
from calrig.calibration.responses import Responses, responses_of


def readings_of_a_drifting_rig(count: int = 60) -> Responses:
    """One channel, white noise of 0.03°, a drift of 0.1° over the run."""
    rng = np.random.default_rng(3)
    targets_deg = rng.permutation(np.linspace(-60.0, 60.0, count))
    errors_deg = 0.8 + 0.1 * np.arange(count) / count + rng.normal(0.0, 0.03, count)
    return responses_of(
        [
            [
                Pose(target_deg=target, reading_deg=target + error, time_s=4.0 * k)
                for k, (target, error) in enumerate(zip(targets_deg, errors_deg, strict=True))
            ]
        ]
    )


def sum_of_squares(y: np.ndarray, columns: np.ndarray) -> float:
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(left @ left)


def test_ratios_of_one_white_channel_are_those_of_least_squares() -> None:
    r = readings_of_a_drifting_rig()
    candidates = candidates_of(r)
    white = NoiseModel(np.array([[1.0 / 0.03]]), np.zeros(1))
    ratios = Screen(r, r.base, candidates, white).ratios(fit(r, r.base).residuals[None])[0]
    y, base = r.values[:, 0], r.base[:, 0, :]
    before = sum_of_squares(y, base)
    expected = [
        len(r) * np.log(before / sum_of_squares(y, np.column_stack([base, c.columns[:, 0, :]])))
        for c in candidates
    ]
    assert {c.columns.shape[2] for c in candidates} >= {1, 2, 3, 5}
    assert ratios == pytest.approx(expected, abs=1e-3)


def test_what_no_bootstrap_reaches_has_the_smallest_p_value_that_so_many_can_tell() -> None:
    """One in B + 1, the observed one counted with them (Davison & Hinkley, 1997, section 4.2); never 0."""
    r = readings_of_a_drifting_rig()
    verdict = gate(r, r.base, fit(r, r.base), candidates_of(r), np.random.default_rng(1), 199)
    assert verdict.p_value == 1 / 200


def test_of_searches_of_noise_no_more_are_accused_than_the_p_value_says() -> None:
    """Among sets of noise that are all alike, each is as likely as any other to be among the best α of them,
    however many families are searched (Westfall & Young, 1993); each family by itself would have its own.
    """
    r = readings_of_a_drifting_rig(40)
    candidates = candidates_of(r)
    assert len({c.family for c in candidates}) > 4
    alike = np.random.default_rng(2).normal(0.0, 0.03, (200, 40, 1))
    white = NoiseModel(np.array([[1.0 / 0.03]]), np.zeros(1))
    ratios = Screen(r, r.base, candidates, white).ratios(alike)
    p_values = np.array(
        [
            Verdict(candidates, ratios[k], 1.0, np.delete(ratios, k, axis=0)).without("nothing").p_value
            for k in range(200)
        ]
    )
    for level in (0.02, 0.05, 0.2, 0.5):  # whose bar moves a little, as each one is left out
        assert (p_values <= level).mean() == pytest.approx(level, abs=0.01)


def test_a_verdict_without_a_candidate_is_that_of_a_search_that_never_looked_at_it() -> None:
    r = readings_of_a_drifting_rig()
    fitted, candidates = fit(r, r.base), candidates_of(r)
    whole = gate(r, r.base, fitted, candidates, np.random.default_rng(1), 199)
    fewer = [c for c in candidates if c.label != "time_drift"]
    never = gate(r, r.base, fitted, fewer, np.random.default_rng(1), 199)
    without = whole.without("time_drift")
    assert without.p_value == never.p_value
    assert without.ratios == pytest.approx(never.ratios, abs=1e-4)


@pytest.mark.parametrize("rho", [-0.3, 0.0, 0.6])
def test_innovations_coloured_again_are_the_residuals(rho: float) -> None:
    rng = np.random.default_rng(4)
    residuals = rng.normal(size=(5, 40, 2))
    noise = NoiseModel(np.array([[2.0, 0.5], [0.0, 1.0]]), np.array([rho, 0.2]))
    of_a_fold, of_two_runs = np.zeros(40, dtype=bool), np.zeros(40, dtype=bool)
    of_two_runs[[0, 17]] = True
    for starts in (of_a_fold, of_two_runs):
        assert noise.colour(noise.whiten(residuals, starts), starts) == pytest.approx(residuals)


def test_poses_that_can_show_no_effect_are_like_noise() -> None:
    readings_deg = 0.8 + np.random.default_rng(5).normal(0.0, 0.03, 20)
    r = responses_of([[Pose(target_deg=0.0, reading_deg=reading) for reading in readings_deg]])
    assert candidates_of(r) == []
    assert gate(r, r.base, fit(r, r.base), [], np.random.default_rng(1), 199).p_value == 1.0
