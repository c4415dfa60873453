"""The gate's likelihood ratios beside plain least squares, and what its verdict rests on."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import Candidate, candidates_of, model_columns
from calrig.calibration.diagnosis.screen import Screen
from calrig.calibration.diagnosis.significance_test import Trial, Verdict, gate
from calrig.calibration.regression.noise_model import NoiseModel, fit
from calrig.calibration.regression.responses import Responses, responses_of


def run_of(targets_deg: np.ndarray, readings_deg: np.ndarray, **known: np.ndarray) -> Responses:
    """A pose every four seconds."""
    time_s = 4.0 * np.arange(len(targets_deg))
    return responses_of([posed(target_deg=targets_deg, reading_deg=readings_deg, time_s=time_s, **known)])


def readings_of_a_drifting_rig(count: int = 60, drift_deg: float = 0.1) -> Responses:
    """One channel, white noise of 0.03°, a drift over the run."""
    rng = np.random.default_rng(3)
    targets_deg = rng.permutation(np.linspace(-60.0, 60.0, count))
    errors_deg = 0.8 + drift_deg * np.arange(count) / count + rng.normal(0.0, 0.03, count)
    return run_of(targets_deg, targets_deg + errors_deg)


def noise_alone(count: int, seed: int) -> Responses:
    rng = np.random.default_rng(seed)
    targets_deg = rng.permutation(np.linspace(-60.0, 60.0, count))
    readings_deg = targets_deg + rng.normal(0.0, 0.03, count)
    return run_of(targets_deg, readings_deg)


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


def judged(r: Responses, bootstraps: int, level: float = 0.01, companions: Collection[str] = ()) -> Verdict:
    def columns_with(more: Sequence[Candidate]) -> np.ndarray:
        return model_columns(r, more)

    rng = np.random.default_rng(1)
    base = fit(r, r.base)
    return gate(r, columns_with, base, candidates_of(r), rng, bootstraps, level, companions=companions)


def test_what_no_bootstrap_comes_near_has_the_smallest_p_value_that_as_many_can_tell() -> None:
    """One in B + 1, the observed one counted with them (Davison & Hinkley, 1997, section 4.2); never 0.

    A fifth of the draws suffices where none of them comes near.
    """
    r = readings_of_a_drifting_rig(drift_deg=0.6)
    assert judged(r, 999).p_value == 1 / 200
    assert judged(r, 99).p_value == 1 / 100


def test_a_search_that_can_no_longer_pass_is_given_up_with_what_it_has_shown() -> None:
    r = noise_alone(40, seed=2)
    verdict = judged(r, 999)
    assert verdict.p_value > 0.1


@pytest.mark.statistical
def test_of_searches_of_noise_no_more_are_accused_than_the_p_value_says() -> None:
    """Each is as likely as any other to be among the best α, however many names are searched."""
    p_values = np.array([judged(noise_alone(40, seed), 99, level=1.0).p_value for seed in range(60)])
    for level in (0.05, 0.2, 0.5):
        expected = 60 * level
        assert abs((p_values <= level).sum() - expected) <= 3.0 * np.sqrt(expected * (1.0 - level)), level


def test_what_is_declared_to_come_along_is_not_lost_among_all_that_could() -> None:
    drifting = readings_of_a_drifting_rig(drift_deg=0.05)
    assert not judged(drifting, 999).passes
    assert judged(drifting, 999, companions={"time_drift"}).passes
    assert not judged(drifting, 999, companions={"backlash"}).passes


@pytest.mark.parametrize("size_deg", [0.12, 0.6, 3.0, 30.0])
@pytest.mark.parametrize("shape", ["drift", "step", "backlash"])
def test_power_grows_with_the_size_of_an_effect(shape: str, size_deg: float) -> None:
    """Up to a thousand times the noise: what is large is no correlation of the noise."""
    count, approach = 52, np.where(np.arange(52) // 13 % 2 == 0, 1, -1)
    of = {
        "drift": np.arange(count) / count,
        "step": (np.arange(count) > 20).astype(float),
        "backlash": 0.5 * approach,
    }
    up = np.linspace(-60.0, 60.0, 13)
    targets = np.concatenate([up, up[::-1], up, up[::-1]])
    readings = targets + size_deg * of[shape] + np.random.default_rng(5).normal(0.0, 0.03, count)
    assert judged(run_of(targets, readings, approach=approach), 99).p_value == 1 / 100


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
    r = responses_of([posed(target_deg=np.zeros(20), reading_deg=readings_deg)])
    assert candidates_of(r) == []
    assert judged(r, 199).p_value == 1.0


def test_where_physics_forbids_all_that_lead_something_is_found_all_the_same() -> None:
    rng = np.random.default_rng(5)
    targets_deg = np.concatenate([np.arange(0.0, 360.0, 4.0), np.arange(356.0, -1.0, -4.0)])
    off_deg = 40.0 * np.sin(np.radians(targets_deg))  # no scale is off its axis by so much of its radius
    r = run_of(targets_deg, targets_deg + off_deg + rng.normal(0.0, 0.03, len(targets_deg)))
    assert judged(r, 99).p_value <= 0.02


def test_once_the_best_is_refused_the_others_are_judged_by_the_same_draws() -> None:
    r = readings_of_a_drifting_rig(drift_deg=0.6)
    first = judged(r, 999)
    refused = first.candidates[int(np.argmax(first.ratios))].label
    others = [c for c in first.candidates if c.label != refused]

    def among_others(rng: np.random.Generator, earlier: Trial | None = None) -> Verdict:
        def columns_with(more: Sequence[Candidate]) -> np.ndarray:
            return model_columns(r, more)

        return gate(r, columns_with, fit(r, r.base), others, rng, 999, 0.01, earlier=earlier)

    rng = np.random.default_rng(1)
    again, anew = among_others(rng, first.trial), among_others(np.random.default_rng(1))
    assert rng.bit_generator.state == np.random.default_rng(1).bit_generator.state, "it drew noise again"
    assert again.candidates == others
    assert (again.gain, again.passes, again.p_value) == (anew.gain, anew.passes, anew.p_value)
    assert again.ratios == pytest.approx(anew.ratios, abs=1e-3)
