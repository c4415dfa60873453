"""Columns that calrig has no physics for: what they may act as, and how they are spoken of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import candidates_of, rebuilt
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.effects.unnamed import delayed
from calrig.calibration.regression.column_units import is_circle, unit_of_column
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.regression.terms import covered

N = 90
TIME_S = 20.0 * np.arange(N)
NOISE_DEG = 0.01


def run_with(error_deg, **columns):
    """Poses in random order, with an error of the reading that follows some columns."""
    rng = np.random.default_rng(4)
    theta = rng.uniform(-60.0, 60.0, N)
    reading = 0.5 + 1.001 * theta + error_deg + rng.normal(0.0, NOISE_DEG, N)
    return posed(target_deg=theta, reading_deg=reading, time_s=TIME_S, settle_s=1.0, **columns)


def found_in(poses):
    effects = document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])["effects"]
    return [(e["name"], e["covariate"], e["evidence"][1].partition(";")[0]) for e in effects], effects


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("azimuth_deg", "°"),
        ("supply_v", "V"),
        ("motor_temperature_c", "°C"),
        ("warming_c_per_min", "°C/min"),
        ("load_nm", "N·m"),
        ("azimuth_deg·supply_v", "°·V"),
        ("azimuth_deg·lamp", ""),
        ("lamp", ""),
        ("c", ""),
        ("_c", ""),
    ],
)
def test_a_unit_is_read_off_the_name(name, unit):
    assert unit_of_column(name) == unit
    assert is_circle(name) is (unit == "°")


def test_an_angle_is_a_circle_and_where_it_is_largest_is_told():
    azimuth_deg = np.mod(250.0 + np.random.default_rng(1).uniform(0.0, 300.0, N), 360.0)
    found, (effect,) = found_in(
        run_with(0.05 * np.cos(np.radians(azimuth_deg - 98.0)), azimuth_deg=azimuth_deg)
    )
    assert found == [("unnamed", "azimuth_deg", "shape: circle, order 1")]
    at, size = effect["parameters"]["at"], effect["parameters"]["size_deg"]
    assert at["value"] == pytest.approx(98.0, abs=4.0 * at["std"])
    assert size["value"] == pytest.approx(0.1, abs=0.01)
    assert f"maximum at {at['value']:.1f}°" in effect["evidence"]
    assert effect["parameters"]["period"]["value"] == 360.0
    assert any("°" in said and "azimuth_deg went from" in said for said in effect["evidence"])


@pytest.mark.parametrize(
    ("deg_per_unit", "column", "unit"), [(-0.013, "tilt_deg", "°"), (0.02, "lamp", "unit of lamp")]
)
def test_a_straight_line_is_told_with_the_sign_of_its_slope(deg_per_unit, column, unit):
    at = np.random.default_rng(6).uniform(-10.0, 10.0, N)
    _, (effect,) = found_in(run_with(deg_per_unit * (at - 3.0), **{column: at}))
    (told,) = (said for said in effect["evidence"] if said.startswith("the reading changes by "))
    value, _, rest = told.removeprefix("the reading changes by ").replace("−", "-").partition(" ± ")
    assert float(value) == pytest.approx(deg_per_unit, abs=0.001)
    assert rest.endswith(f"° per {unit}")


def test_an_arc_is_what_the_widest_gap_leaves_of_the_circle():
    assert covered(np.array([350.0, 5.0, 20.0])) == pytest.approx(30.0)
    assert covered(np.array([-170.0, 170.0])) == pytest.approx(20.0)


LOAD_KG = np.repeat(np.random.default_rng(9).uniform(0.0, 2.0, N // 9), 9)


def behind_a_lag(column, lag_s):
    """y' = (z − y)/lag by Euler's steps of a hundredth of a second, z straight between poses."""
    fine_s = np.arange(0.0, TIME_S[-1] + 0.01, 0.01)
    z = np.interp(fine_s, TIME_S, column)
    y = z[0]
    stepped = [y := y + 0.01 * (between - y) / lag_s for between in (z[1:] + z[:-1]) / 2.0]
    return np.interp(TIME_S, fine_s, [z[0], *stepped])


def test_a_residual_that_follows_the_rate_of_a_column_is_traced_to_its_rate():
    """The derivative as mathematics has it, not as differences do."""
    w = 2.0 * np.pi / 900.0
    load_kg = np.sin(w * TIME_S) + 0.3 * np.sin(3.3 * w * TIME_S)
    rate = w * np.cos(w * TIME_S) + 0.99 * w * np.cos(3.3 * w * TIME_S)
    assert found_in(run_with(0.05 * rate / rate.std(), load_kg=load_kg))[0] == [
        ("unnamed", "load_kg", "shape: rate")
    ]


def test_a_lag_is_that_of_its_differential_equation():
    r = responses_of([run_with(0.0, load_kg=LOAD_KG)])
    np.testing.assert_allclose(delayed(r, "load_kg", 60.0), behind_a_lag(LOAD_KG, 60.0), atol=1e-4)


def test_a_residual_that_follows_a_column_late_is_traced_to_its_delay():
    found, effects = found_in(run_with(0.1 * behind_a_lag(LOAD_KG, 100.0), load_kg=LOAD_KG))
    assert found[0] == ("unnamed", "load_kg", "shape: delayed")
    assert effects[0]["parameters"]["lag_s"]["value"] == pytest.approx(100.0, rel=0.5)


def test_two_columns_act_as_a_product_once_both_are_in_the_model():
    rng = np.random.default_rng(7)
    supply_v, load_kg = rng.normal(5.0, 0.2, N), rng.normal(2.0, 0.3, N)
    s, w = (supply_v - 5.0) / 0.2, (load_kg - 2.0) / 0.3
    names, _ = found_in(run_with(0.05 * s + 0.05 * w + 0.04 * s * w, supply_v=supply_v, load_kg=load_kg))
    assert sorted(covariate for _, covariate, _ in names[:2]) == ["load_kg", "supply_v"]
    assert names[2] == ("unnamed", "supply_v·load_kg", "shape: product")


def with_gravity(poses, turned_deg):
    """The same poses with an accelerometer that sees some of what moves the reading, and 0.02° of noise."""
    noise = np.random.default_rng(5).normal(0.0, 0.02, (N, 2))
    true_deg = np.array([pose.target_deg for pose in poses]) + turned_deg
    y, z = np.sin(np.radians(true_deg + noise[:, 0])), np.cos(np.radians(true_deg + noise[:, 1]))
    return [replace(p, accel_y_g=float(a), accel_z_g=float(b)) for p, a, b in zip(poses, y, z, strict=True)]


SUPPLY_V = 5.0 + 0.25 * np.sign(np.sin(TIME_S / 90.0))
OF_SUPPLY_DEG = 0.3 * (SUPPLY_V - 5.0)


@pytest.mark.parametrize(
    ("gravity_deg", "form"),
    [(0.0 * OF_SUPPLY_DEG, "linear, of the reading alone"), (OF_SUPPLY_DEG, "linear")],
)
def test_a_column_is_accused_whether_gravity_sees_what_it_does_or_not(gravity_deg, form):
    _, (effect,) = found_in(with_gravity(run_with(OF_SUPPLY_DEG, supply_v=SUPPLY_V), gravity_deg))
    assert (effect["name"], effect["covariate"]) == ("unnamed", "supply_v")
    assert f"shape: {form}; no effect of the catalogue explains it as well" in effect["evidence"]
    assert effect["parameters"]["size_deg"]["value"] == pytest.approx(0.15, abs=0.02)
    told = "the reading moved and the accelerometer did not: look at what filters the reading"
    assert (told in effect["evidence"]) is form.endswith("alone")


def test_a_reading_that_strays_where_gravity_does_not_is_said_to():
    wanders_deg = 0.2 * np.sin(TIME_S / 60.0)
    diagnosis = diagnose([with_gravity(run_with(wanders_deg), 0.0)], bootstraps=99, cross_fit=False)
    assert any("gravity does not see what moves it" in said for said in diagnosis.warnings)
    both = diagnose([with_gravity(run_with(wanders_deg), wanders_deg)], bootstraps=99, cross_fit=False)
    assert not any("gravity" in said for said in both.warnings)


def test_a_product_alone_is_no_candidate_of_its_own():
    rng = np.random.default_rng(7)
    s, w = rng.normal(0.0, 1.0, N), rng.normal(0.0, 1.0, N)
    names, _ = found_in(run_with(0.05 * s * w, supply_v=s, load_kg=w))
    assert not [name for name in names if "·" in name[1]]


def test_every_form_of_a_column_is_rebuilt_in_other_poses():
    rng = np.random.default_rng(2)
    columns = {"azimuth_deg": rng.uniform(0.0, 360.0, N), "load_kg": LOAD_KG}
    r = responses_of([run_with(0.0, **columns)])
    fewer = responses_of([run_with(0.0, **columns)[:70]])
    for candidate in candidates_of(r):
        if candidate.covariate in {"azimuth_deg", "load_kg", "azimuth_deg·load_kg"}:
            again = rebuilt(candidate, fewer)
            assert again is not None
            assert (again.label, again.shape.form) == (candidate.label, candidate.shape.form)


@pytest.mark.parametrize("alone_deg", [0.0, 0.3])
def test_a_column_that_changes_the_scale_is_found_with_its_bias_and_without(alone_deg):
    rng = np.random.default_rng(9)
    supply_v = rng.uniform(-1.0, 1.0, N)
    at_deg = np.array([pose.target_deg for pose in run_with(0.0)])
    names, _ = found_in(run_with(alone_deg * supply_v + 0.006 * at_deg * supply_v, supply_v=supply_v))
    followed = {covariate for _, covariate, _ in names}
    assert "target_deg·supply_v" in followed
    assert "supply_v" in followed or not alone_deg
    assert followed <= {"target_deg·supply_v", "supply_v"}
