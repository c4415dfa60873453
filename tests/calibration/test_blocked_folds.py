"""Blocks left out whole: what interpolates is told from what predicts."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed
from support import one_now

from calrig.calibration.diagnosis.candidates import Candidate, candidates_of, model_columns
from calrig.calibration.diagnosis.held_out import blocked, not_predictive
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.line import rms
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import Responses, responses_of

N_POSES = 96
NOISE_DEG = 0.01
TIMES_S = 5.0 * np.arange(N_POSES)
ALONG = ("time", "angle")


def run_of(error_deg: np.ndarray, seed: int = 3) -> Responses:
    """A run over random elevations whose readings err by so much."""
    rng = np.random.default_rng(seed)
    theta_deg = rng.uniform(-60.0, 60.0, N_POSES)
    readings = 0.5 + 1.001 * theta_deg + error_deg + rng.normal(0.0, NOISE_DEG, N_POSES)
    return responses_of([posed(target_deg=theta_deg, reading_deg=readings, time_s=TIMES_S)])


def one(r: Responses, name: str, form: str = "") -> Candidate:
    """A candidate that follows time."""
    return next(c for c in candidates_of(r) if (c.name, c.shape.form, c.covariate) == (name, form, "time_s"))


def judged(r: Responses, candidate: Candidate) -> str:
    """The verdict on a name that stood alone, once it has to predict blocks."""
    whole = fit(r, model_columns(r, [candidate]))
    (found,) = not_predictive(r, [SelectedEffect(candidate, (), 0.001, 50.0)], whole, candidates_of(r))
    return found.verdict


def test_a_true_drift_predicts_every_block() -> None:
    r = run_of(4e-4 * TIMES_S)
    drift = one(r, "time_drift")
    errors = {b.along: (rms(b.base_deg), rms(b.final_deg)) for b in blocked(r, [drift])}
    assert tuple(errors) == ALONG
    for before_deg, after_deg in errors.values():
        assert after_deg < 1.5 * NOISE_DEG < 3.0 * NOISE_DEG < before_deg
    assert judged(r, drift) == "named"


def test_a_line_through_what_wanders_and_comes_back_is_not_claimed() -> None:
    """It rises, and falls again: a drift explains part of that, and predicts its end wrongly."""
    r = run_of(0.2 * np.sin(np.linspace(0.0, 4.0, N_POSES)))
    assert judged(r, one(r, "time_drift")) == "ambiguous"


def test_a_curve_of_time_is_good_between_poses_and_bad_beyond_them() -> None:
    r = run_of(np.cumsum(np.random.default_rng(8).normal(0.0, 0.03, N_POSES)))
    in_time, in_angle = blocked(r, [one(r, "unnamed", "smooth 5")])
    assert (in_time.along, in_angle.along) == ALONG
    assert rms(in_angle.final_deg) < 0.6 * rms(in_angle.base_deg)
    assert rms(in_time.final_deg) > rms(in_time.base_deg)


def test_a_run_whose_first_pose_was_left_out_is_laid_in_the_same_blocks() -> None:
    r = run_of(4e-4 * TIMES_S)
    rest = np.arange(1, N_POSES)
    later = blocked(r.rows(rest), [one(r, "time_drift").rows(rest)])
    assert tuple(b.along for b in later) == ALONG
    assert all(rms(b.final_deg) < 1.5 * NOISE_DEG for b in later)


def test_a_block_that_hides_an_effect_is_predicted_without_it() -> None:
    """A slip after the eighth pose: without the first block it is a bias like any other."""
    r = run_of(0.3 * (TIMES_S > 37.0))
    slip = next(c for c in candidates_of(r) if c.name == "mount_slip" and 35.0 < c.shape.at["at_s"] < 40.0)
    in_time = blocked(r, [slip])[0]
    first = np.arange(N_POSES) < N_POSES // 4
    assert in_time.final_deg[first] == pytest.approx(in_time.base_deg[first], abs=0.01)
    assert rms(in_time.final_deg[~first]) < 0.5 * rms(in_time.base_deg[~first])


def test_poses_at_one_elevation_are_blocked_in_time_alone() -> None:
    there = np.full(N_POSES, 20.0)
    r = responses_of([posed(target_deg=there, reading_deg=there + 1e-3 * TIMES_S, time_s=TIMES_S)])
    assert [b.along for b in blocked(r, [one(r, "time_drift")])] == ["time"]


ORDERS = range(2, 12)


def one_turn(seed: int, amplitudes_deg: dict[float, float]) -> tuple[Responses, list[Candidate]]:
    """64 poses of one turn with waves of some periods, and those waves."""
    rng = np.random.default_rng(seed)
    theta_deg = 5.625 * np.arange(64.0) + rng.uniform(-1.0, 1.0, 64)
    readings = theta_deg + rng.normal(0.0, NOISE_DEG, 64)
    for period_deg, amplitude_deg in amplitudes_deg.items():
        readings += amplitude_deg * np.sin(2.0 * np.pi * theta_deg / period_deg + rng.uniform(0.0, 6.3))
    r = responses_of([posed(target_deg=theta_deg, reading_deg=readings)])
    periodic = [c for c in candidates_of(r) if c.name == "stage_periodic" and c.beside is None]
    nearest = {p: min(periodic, key=lambda c: abs(c.shape.at["period_deg"] - p)) for p in amplitudes_deg}
    return r, [nearest[p] for p in amplitudes_deg]


@pytest.mark.parametrize("seed", one_now(range(8)))
def test_many_orders_do_not_fly_off_in_the_gap_of_a_block(seed: int) -> None:
    r, waves = one_turn(seed, {360.0 / k: 0.3 / k**2 for k in ORDERS})
    (along_angle,) = blocked(r, waves)
    assert rms(along_angle.final_deg) < 2.0 * rms(along_angle.base_deg)


@pytest.mark.parametrize("seed", one_now(range(8)))
def test_many_waves_within_a_block_are_foreseen_as_they_are(seed: int) -> None:
    r, waves = one_turn(seed, {360.0 / k: 0.05 for k in (6, 11, 16, 21, 26)})
    (along_angle,) = blocked(r, waves)
    assert rms(along_angle.final_deg) < 3.0 * NOISE_DEG < 0.05 < rms(along_angle.base_deg)


@pytest.mark.parametrize("column", ["time_s", "approach"])
def test_blocks_of_rows_are_called_by_what_gives_their_order(column: str) -> None:
    theta_deg = np.random.default_rng(3).uniform(-60.0, 60.0, 48)
    known = {"time_s": 5.0 * np.arange(48), "approach": np.sign(np.diff(theta_deg, prepend=0.0))}[column]
    diagnosed = diagnose(
        [posed(target_deg=theta_deg, reading_deg=theta_deg, **{column: known})], bootstraps=99
    )
    along = {"time_s": "time", "approach": "the rows"}[column]
    assert f"blocks along {along} and along angle" in document(diagnosed, ["a run"])["held_out"]["how"]
