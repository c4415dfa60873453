"""A kink and a step of the error lie where they are, not at the nearest place that was scanned."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of, rebuilt
from calrig.calibration.diagnosis.ranking import at_best_place
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.regression.request import DiagnosisRequest
from calrig.calibration.regression.responses import responses_of

GOOD = DiagnosisRequest(reference="good")
TURN_DEG = np.arange(0.0, 360.0, 4.0)
NOISE_DEG = 0.05


def read(theta_deg, error_deg, **columns):
    noise_deg = np.random.default_rng(22).normal(0.0, NOISE_DEG, len(theta_deg))
    return posed(target_deg=theta_deg, reading_deg=theta_deg + error_deg + noise_deg, **columns)


def diagnosed(poses, *, cross_fit=False):
    return document(diagnose([poses], request=GOOD, bootstraps=199, cross_fit=cross_fit), ["1"])


def scanned_near(r, covariate, form, place):
    shapes = [c for c in candidates_of(r) if (c.covariate, c.shape.form) == (covariate, form)]
    return min(shapes, key=lambda c: abs(c.shape.at["at"] - place))


def kink_by_hand(z, error_deg, near):
    """Return where a straight line with one kink leaves least, of places a hundredth of a unit apart."""
    places = near + np.arange(-4.0, 4.0, 0.01)
    line = np.column_stack([np.ones_like(z), z])

    def left(place):
        columns = np.column_stack([line, np.maximum(z - place, 0.0)])
        return np.sum((error_deg - columns @ np.linalg.lstsq(columns, error_deg, rcond=None)[0]) ** 2)

    return min(places, key=left)


@pytest.mark.parametrize("slope", [-0.2, -0.8, 0.3])
def test_a_kink_in_a_full_turn_is_no_list_of_orders(slope):
    poses = read(TURN_DEG, slope * np.maximum(TURN_DEG - 300.0, 0.0))
    found = diagnosed(poses, cross_fit=slope == -0.2)
    ((name, kink),) = ((e["name"], e) for e in found["effects"])
    assert (name, kink["evidence"][1].partition(";")[0]) == ("unnamed", "shape: kink")
    expected = kink_by_hand(TURN_DEG, np.array([p.reading_deg - p.target_deg for p in poses]), 300.0)
    assert kink["parameters"]["at"]["value"] == pytest.approx(expected, abs=0.02)
    if slope == -0.2:  # in each fold it lies where it is, too, and means the same in all poses
        assert found["final"]["held_out_rms_deg"] < 1.3 * NOISE_DEG


def test_a_step_is_in_the_middle_of_its_gap_and_no_pose_beside_it_is_an_outlier():
    found = diagnosed(read(TURN_DEG, 2.0 * (TURN_DEG > 257.0)))
    (step,) = found["effects"]
    assert step["evidence"][1].startswith("shape: step")
    assert step["parameters"]["at"]["value"] == 258.0
    assert found["n_poses"] == len(TURN_DEG)


@pytest.mark.parametrize("count", [60, 700])
def test_a_step_is_found_among_few_gaps_and_many(count):
    theta_deg = np.random.default_rng(3).uniform(-60.0, 60.0, count)
    r = responses_of([read(theta_deg, 0.5 * (theta_deg > 17.0))])
    step = at_best_place(r, [], scanned_near(r, "target_deg", "step", 17.0))
    gap_deg = theta_deg[theta_deg <= 17.0].max(), theta_deg[theta_deg > 17.0].min()
    assert step.shape.at["at"] == pytest.approx(np.mean(gap_deg))


@pytest.mark.parametrize("form", ["kink", "step"])
def test_where_nearly_all_poses_have_one_value_it_stays_where_it_was_scanned(form):
    theta_deg = np.random.default_rng(3).uniform(-60.0, 60.0, 200)
    load_kg = np.append(np.full(191, 2.0), np.arange(9.0))
    r = responses_of([read(theta_deg, 0.5 * (load_kg > 2.0), load_kg=load_kg)])
    one = scanned_near(r, "load_kg", form, 2.0)
    assert at_best_place(r, [], one).shape.at == one.shape.at


@pytest.mark.parametrize("column", ["load_kg", "temperature_c"])
def test_a_kink_of_another_column_lies_where_it_is(column):
    rng = np.random.default_rng(5)
    z, theta_deg = rng.uniform(0.0, 50.0, 200), rng.uniform(-60.0, 60.0, 200)
    r = responses_of([read(theta_deg, 0.05 * np.maximum(z - 29.0, 0.0), **{column: z})])
    kink = at_best_place(r, [], scanned_near(r, column, "kink", 29.0))
    assert kink.shape.at["at"] == pytest.approx(29.0, abs=0.5)


@pytest.mark.parametrize("form", ["kink", "step"])
def test_in_all_poses_it_is_what_it_is_in_some(form):
    r = responses_of([read(TURN_DEG, 0.1 * np.maximum(TURN_DEG - 203.0, 0.0) + (TURN_DEG > 203.0))])
    some = np.arange(5, 80)  # of a smaller range
    fold = r.rows(some)
    found = at_best_place(fold, [], scanned_near(r, "target_deg", form, 203.0).rows(some))
    whole = rebuilt(found, r)
    assert whole is not None
    assert whole.shape.at == found.shape.at
    assert np.array_equal(whole.columns[some], found.columns)
    short = r.rows(np.arange(40))  # that do not reach so far: there it adds nothing
    there = rebuilt(found, short)
    assert there is not None
    assert not there.columns.any()
    assert fitted_model(short, [there]).fitted.criterion == pytest.approx(
        fitted_model(short, []).fitted.criterion
    )
