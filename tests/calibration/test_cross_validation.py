"""Held-out poses are held out: of search and fit alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posed import posed
from support import one_now

from calrig.calibration.diagnosis import diagnose
from calrig.calibration.diagnosis.candidates import candidates_of
from calrig.calibration.diagnosis.held_out import FOLDS, CrossValidation, cross_validate, errors_deg, folds_of
from calrig.calibration.diagnosis.report import slopes_of_errors
from calrig.calibration.diagnosis.tracing import document
from calrig.calibration.line import rms
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.responses import Responses, responses_of

FIRST = 0
"""The fold that is left out first: what the others do is no part of how its search is drawn."""


def readings_of_a_stage_with_play(count: int = 48) -> Responses:
    """Backlash of 0.12° in noise of 0.03°, over random elevations."""
    rng = np.random.default_rng(7)
    theta = rng.uniform(-60.0, 60.0, count)
    approach = np.sign(np.diff(theta, prepend=0.0))
    readings = 0.8 + 1.002 * theta - 0.06 * approach + rng.normal(0.0, 0.03, count)
    return responses_of([posed(target_deg=theta, reading_deg=readings, approach=approach)])


def validated(r: Responses) -> CrossValidation:
    few = [c for c in candidates_of(r) if c.name in {"backlash", "settling"}]
    return cross_validate(r, few, np.random.default_rng(1))


def test_what_a_held_out_pose_reads_changes_its_own_error_by_that_much_and_no_prediction() -> None:
    r = readings_of_a_stage_with_play()
    held_out = np.flatnonzero(folds_of(r) == FIRST)
    shifts_deg = np.random.default_rng(2).normal(0.0, 1.0, len(held_out))
    values = r.values.copy()
    values[held_out, 0] += shifts_deg
    before, after = validated(r), validated(replace(r, values=values))
    for of_before, of_after in ((before.base_deg, after.base_deg), (before.final_deg, after.final_deg)):
        assert (of_after - of_before)[held_out] == pytest.approx(shifts_deg, rel=0.01)  # over the scale
    assert rms(before.final_deg[held_out]) < 0.7 * rms(before.base_deg[held_out]), "nothing was found"


def test_every_pose_is_held_out_once_by_a_fold_that_has_both_approaches() -> None:
    r = readings_of_a_stage_with_play()
    fold = folds_of(r)
    assert np.ptp(np.bincount(fold)) <= 1
    for k in range(FOLDS):
        assert {-1.0, 1.0} <= set(r.approach[fold == k])


STEP_DEG = 9.0
UP = STEP_DEG * np.arange(320.0)


@pytest.mark.parametrize(
    "theta_deg",
    [
        pytest.param(UP, id="forty a turn over eight turns"),
        pytest.param(STEP_DEG * np.arange(2000.0), id="over fifty turns"),
        pytest.param(np.concatenate([UP, UP[::-1]]), id="up and down"),
        pytest.param(
            np.concatenate([UP, UP[::-1] + STEP_DEG / 4.0]), id="up, and down a quarter of a step beside"
        ),
        pytest.param(np.repeat(UP, 2), id="each angle twice"),
        pytest.param(UP + np.random.default_rng(4).normal(0.0, 1.0, len(UP)), id="nearly even"),
    ],
)
def test_the_rest_of_a_fold_shows_every_wave_that_all_poses_show(theta_deg: np.ndarray) -> None:
    r = responses_of([posed(target_deg=theta_deg, reading_deg=theta_deg)])
    turns = np.radians(np.outer(theta_deg, np.arange(20)))
    waves = np.column_stack([np.cos(turns), np.sin(turns[:, 1:])])
    fold = folds_of(r)
    for k in range(FOLDS):
        least = np.linalg.svd(waves[fold != k], compute_uv=False)[-1]
        assert least > 0.2 * np.linalg.svd(waves, compute_uv=False)[-1]


def test_errors_of_held_out_poses_are_of_elevation_not_of_reading() -> None:
    """A reading of 0.8·θ + 1° with an error of 0.1° stands for an elevation that is 0.125° off."""
    theta_deg = np.random.default_rng(3).uniform(-60.0, 60.0, 20)
    readings_deg = 0.8 * theta_deg + 1.0
    r = responses_of([posed(target_deg=theta_deg, reading_deg=readings_deg)])
    beta = fit(r, r.base).beta
    values = r.values.copy()
    values[5, 0] += 0.1
    errors = errors_deg(replace(r, values=values), (), beta, np.array([4, 5]), slopes_of_errors(r, (), beta))
    assert errors == pytest.approx([0.0, 0.125], abs=1e-6)


def test_errors_beside_a_curve_are_of_the_elevation_that_solves_it() -> None:
    """A reading θ + θ²/200°, from 0° on, with noise of 0.05°: its slope goes from 1 to 2.2."""
    theta_deg = np.repeat(np.arange(0.0, 121.0, 2.0), 4)
    noise_deg = np.random.default_rng(5).normal(0.0, 0.05, len(theta_deg))
    readings_deg = theta_deg * (1.0 + theta_deg / 200.0) + noise_deg
    found = diagnose([posed(target_deg=theta_deg, reading_deg=readings_deg)])
    assert [f.candidate.name for f in found.findings.found] == ["nonlinearity"]
    solved_deg = 100.0 * (np.sqrt(np.maximum(1.0 + readings_deg / 50.0, 0.0)) - 1.0)
    assert rms(found.held_out.final_deg) == pytest.approx(rms(solved_deg - theta_deg), rel=0.05)
    stated = document(found, ["1"])["final"]
    assert stated["fit_rms_deg"] == pytest.approx(rms(solved_deg - theta_deg), rel=0.02)


@pytest.mark.parametrize("offset_g", one_now([0.08, -0.08]))
def test_errors_beside_an_offset_of_the_axes_are_of_the_elevation_that_solves_it(offset_g: float) -> None:
    """From 0 to 80° with 80 mg on an axis, the angle of gravity grows by up to 8 % more, or less."""
    theta_deg = np.repeat(np.arange(0.0, 81.0, 2.0), 4)
    rng = np.random.default_rng(6)

    def read_deg(at_deg: np.ndarray) -> np.ndarray:
        turn = np.radians(at_deg)
        return np.degrees(np.arctan2(np.sin(turn) + offset_g, np.cos(turn)))

    readings_deg = read_deg(theta_deg) + rng.normal(0.0, 0.05, len(theta_deg))
    turn = np.radians(theta_deg)
    y_g, z_g = (g + rng.normal(0.0, 1e-3, len(turn)) for g in (np.sin(turn) + offset_g, np.cos(turn)))
    poses = posed(
        target_deg=theta_deg, reading_deg=readings_deg, accel_x_g=0.0 * turn, accel_y_g=y_g, accel_z_g=z_g
    )
    found = diagnose([poses])
    assert [f.candidate.name for f in found.findings.found] == ["accelerometer_offset"]
    fine_deg = np.linspace(-20.0, 100.0, 200_001)
    solved_deg = np.interp(readings_deg, read_deg(fine_deg), fine_deg)
    stated = document(found, ["1"])["final"]
    assert stated["fit_rms_deg"] == pytest.approx(rms(solved_deg - theta_deg), rel=0.02)


def test_the_error_before_is_that_of_a_calibrations_own_line_however_the_noise_wanders() -> None:
    rng = np.random.default_rng(4)
    theta_deg = np.repeat(rng.uniform(-60.0, 60.0, 30), 8)
    wander_deg = np.cumsum(rng.normal(0.0, 0.5, 240)) - 0.5 * (theta_deg - np.roll(theta_deg, 1))
    r = responses_of(
        [posed(target_deg=theta_deg, reading_deg=theta_deg + wander_deg, time_s=np.arange(240.0))]
    )
    fold, errors = folds_of(r), np.empty(240)
    for k in range(FOLDS):
        line = np.polyfit(theta_deg[fold != k], (theta_deg + wander_deg)[fold != k], 1)
        errors[fold == k] = ((theta_deg + wander_deg - np.polyval(line, theta_deg)) / line[0])[fold == k]
    before = cross_validate(r, [], np.random.default_rng(1)).base_deg
    assert rms(before) == pytest.approx(rms(errors), rel=0.02)


def test_a_curve_of_a_fold_keeps_its_knots_where_an_outlier_has_left():
    """The outlier lay beyond all others: a curve that is built anew without it has knots elsewhere."""
    rng = np.random.default_rng(5)
    theta_deg = np.append(rng.uniform(-60.0, 60.0, 119), 75.0)
    errors_deg = 0.3 * np.exp(-(((theta_deg - 10.0) / 15.0) ** 2)) + rng.normal(0.0, 0.01, 120)
    r = responses_of([posed(target_deg=theta_deg, reading_deg=theta_deg + errors_deg)])
    kept = np.arange(119)
    curves = [c for c in candidates_of(r) if c.shape.form == "smooth 9" and c.beside is None]
    found = cross_validate(r.rows(kept), [c.rows(kept) for c in curves], np.random.default_rng(1))
    assert rms(found.final_deg) < 0.02
