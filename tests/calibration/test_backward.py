"""A model as a whole: effects that cannot be, that cancel, or that others have explained since."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import Candidate, candidate_of
from calrig.calibration.diagnosis.ranking import SelectedEffect
from calrig.calibration.diagnosis.reselection import eliminated, is_admissible
from calrig.calibration.effects import effect_of
from calrig.calibration.regression.responses import Responses, responses_of

N_POSES = 96
NOISE_DEG = 0.01
RNG = np.random.default_rng(11)
THETA_DEG = RNG.uniform(-60.0, 60.0, N_POSES)
APPROACH = np.sign(np.diff(THETA_DEG, prepend=0.0))
TIME_S = 5.0 * np.arange(N_POSES)
WARMER_C = 6.0 * (1.0 - np.exp(-TIME_S / 150.0))


def run_of(error_deg: np.ndarray) -> Responses:
    """A run over random elevations whose readings err by so much, noise beside."""
    readings_deg = 0.5 + THETA_DEG + error_deg + np.random.default_rng(3).normal(0.0, NOISE_DEG, N_POSES)
    known = {"approach": APPROACH, "time_s": TIME_S, "temperature_c": 24.0 + WARMER_C}
    return responses_of([posed(target_deg=THETA_DEG, reading_deg=readings_deg, **known)])


def one(r: Responses, name: str, form: str = "") -> Candidate:
    return next(candidate_of(r, effect_of(name), s) for s in effect_of(name).forms(r, {}) if s.form == form)


def labels_of(r: Responses, *names: str) -> tuple[list[str], list[str]]:
    """Names kept and dropped of a model that they entered in this order."""
    found = [SelectedEffect(one(r, name), (), 0.001, np.inf) for name in names]
    kept, dropped = eliminated(r, found)
    return [f.candidate.label for f in kept], dropped


def test_effects_that_are_there_stay_in_whatever_order_they_came() -> None:
    r = run_of(0.05 * APPROACH + 0.02 * WARMER_C)
    assert labels_of(r, "backlash", "temperature_bias") == (["backlash", "temperature_bias"], [])
    assert labels_of(r, "temperature_bias", "backlash") == (["temperature_bias", "backlash"], [])


def test_an_effect_that_a_later_one_explains_is_dropped() -> None:
    """A drift was the best of the first step; it was the warm-up."""
    r = run_of(0.02 * WARMER_C)
    assert labels_of(r, "time_drift", "temperature_bias") == (["temperature_bias"], ["time_drift"])


def test_an_effect_that_another_one_rests_on_is_not_dropped() -> None:
    r = run_of(0.0 * WARMER_C)
    kept, _ = labels_of(r, "temperature_bias", "temperature_curvature")
    assert kept == ["temperature_bias", "temperature_curvature"]


def waves(r: Responses, *periods_deg: float) -> list[Candidate]:
    effect = effect_of("stage_periodic")
    return [
        candidate_of(r, effect, shape) for p in periods_deg for shape in effect.forms(r, {"period_deg": p})
    ]


def test_two_waves_that_cancel_are_refused_and_two_that_are_there_are_not() -> None:
    r = run_of(1e-5 * THETA_DEG**3)
    assert not is_admissible(r, waves(r, 150.0, 165.0))
    both = run_of(0.1 * np.sin(np.radians(8.0 * THETA_DEG)) + 0.1 * np.sin(np.radians(20.0 * THETA_DEG)))
    assert is_admissible(both, waves(both, 45.0, 18.0))


@pytest.mark.parametrize(
    ("name", "form", "size_deg", "is_possible"),
    [
        ("stage_eccentricity", "", 3.0, True),
        ("stage_eccentricity", "", 60.0, False),
        ("axis_mismatch", "gain_pct", 1.0, True),
        ("axis_mismatch", "gain_pct", 10.0, False),
        ("accelerometer_offset", "y_mg", 4.0, True),
        ("accelerometer_offset", "y_mg", 20.0, False),
    ],
)
def test_what_no_sensor_and_no_stage_can_have_is_refused(
    name: str, form: str, size_deg: float, is_possible: bool
) -> None:
    """So large a part of the reading, of an effect's own shape."""
    theta = np.radians(THETA_DEG)
    shapes = {"stage_eccentricity": np.sin(theta), "axis_mismatch": np.sin(2.0 * theta)}
    r = run_of(size_deg * shapes.get(name, np.cos(theta)))
    assert is_admissible(r, [one(r, name, form)]) is is_possible
