"""Delays behind the thermometer: named where warming and cooling differ, never from one leg alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from studies.blind.causes import package_turn, slow_heat
from studies.blind.cells import CELLS, Cell
from studies.blind.physics import Cause
from support import one_now

from calrig.calibration.diagnosis.tracing import diagnose, document

LAG_S = 40.0


def traced(poses):
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])["effects"]


def heated_late(_rng, _when):
    """Heat reaches the package late, on one leg of warming."""
    return Cause("thermal_hysteresis", "sensor", "temperature_c", {"environment": {"stress_lag_s": LAG_S}})


def test_a_delay_is_named_where_the_temperature_came_back_and_its_lag_is_told():
    poses = Cell("there and back", "two", (package_turn(0.05), slow_heat(LAG_S))).run(seed=1).poses
    bias, delay = traced(poses)
    assert (bias["name"], bias["verdict"]) == ("temperature_bias", "named")
    assert (delay["name"], delay["verdict"]) == ("thermal_hysteresis", "named")
    lag_s = delay["parameters"]["lag_s"]
    assert lag_s["value"] == pytest.approx(LAG_S, abs=3.0 * lag_s["std"])
    follows, ahead = bias["parameters"]["deg_per_c"], delay["parameters"]["deg_per_c"]
    assert ahead["value"] == pytest.approx(-follows["value"], abs=3.0 * (ahead["std"] + follows["std"]))


@pytest.mark.parametrize("seed", one_now([1, 2, 3]))
def test_one_leg_of_warming_names_neither_a_delay_nor_a_curve_that_it_could_be(seed):
    poses = Cell("one leg", "two", (package_turn(0.3), heated_late)).run(seed).poses
    effects = traced(poses)
    suspects = {"thermal_hysteresis", "temperature_curvature", "time_drift"}
    assert effects
    assert not any(e["verdict"] == "named" and e["name"] in suspects for e in effects)


def test_on_one_leg_the_delay_is_a_suspect_and_it_is_said_what_would_tell():
    poses = Cell("one leg", "two", (package_turn(0.3), heated_late)).run(seed=2).poses
    _, delay = traced(poses)
    assert {"thermal_hysteresis", "temperature_curvature"} <= {delay["name"], *delay["confusable_with"]}
    assert any("one way only" in sentence for sentence in delay["evidence"])


def test_a_column_of_the_rate_of_change_is_traced_like_any_other():
    rng = np.random.default_rng(3)
    quiet = CELLS["null white"].run(seed=3).poses
    rate = np.cumsum(rng.normal(0.0, 0.02, len(quiet)))
    poses = [
        dataclasses.replace(
            pose,
            reading_deg=pose.reading_deg + 3.0 * float(rate[k]),
            accel_y_g=None,
            accel_z_g=None,
            time_s=None,
            temperature_c=None,
            covariates={"warming_c_per_s": float(rate[k])},
        )
        for k, pose in enumerate(quiet)
    ]
    (effect,) = traced(poses)
    assert (effect["verdict"], effect["covariate"]) == ("unnamed", "warming_c_per_s")


def test_what_a_witness_alone_shows_names_no_effect_of_the_reading():
    quiet = CELLS["null white"].run(seed=5).poses
    longer = 1.0 + 4e-3 * np.sin(np.arange(len(quiet)) / 9.0)
    poses = [
        dataclasses.replace(
            pose, accel_y_g=pose.accel_y_g * float(longer[k]), accel_z_g=pose.accel_z_g * float(longer[k])
        )
        for k, pose in enumerate(quiet)
    ]
    assert not [effect for effect in traced(poses) if effect["verdict"] == "named"]
