"""A model as a whole: effects that cannot be, that cancel, or that others have explained since."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.candidates import Candidate, candidate_of, candidates_of
from calrig.calibration.diagnosis.ranking import MARGIN, SelectedEffect, named
from calrig.calibration.diagnosis.reselection import (
    admitted,
    eliminated,
    is_admissible,
    penalised_criterion,
    reselected,
)
from calrig.calibration.diagnosis.screen import Screen
from calrig.calibration.diagnosis.sensor_model import fitted_model
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


def test_two_waves_that_cancel_are_refused_beside_a_large_one_too() -> None:
    """What all three add together is large, so their sum does not show how little is left of the two."""
    r = run_of(1e-6 * THETA_DEG**3 + 3.0 * np.sin(np.radians(8.0 * THETA_DEG)))
    assert not is_admissible(r, waves(r, 45.0, 150.0, 165.0))


def test_of_effects_that_cancel_one_leaves_and_what_was_there_before_stays() -> None:
    r = run_of(1e-6 * THETA_DEG**3 + 3.0 * np.sin(np.radians(8.0 * THETA_DEG)))
    entered = [SelectedEffect(candidate, (), 0.001, np.inf) for candidate in waves(r, 45.0, 150.0, 165.0)]
    left = admitted(r, entered[:1], entered, known=2)
    assert left == entered[:2]
    assert admitted(r, entered[:2], entered, known=2) is None, "no better than without what entered"


TO_AND_FRO_DEG = np.concatenate([half := np.sort(RNG.uniform(-180.0, 180.0, 100)), half[::-1]])
TO_AND_FRO = np.radians(TO_AND_FRO_DEG)
LASTING_S = 5.0 * np.arange(len(TO_AND_FRO))


def turn_of(error_deg: np.ndarray) -> Responses:
    """A turn and back, whose readings err by so much, noise beside."""
    noise_deg = np.random.default_rng(3).normal(0.0, NOISE_DEG, len(TO_AND_FRO))
    return responses_of(
        [
            posed(
                target_deg=TO_AND_FRO_DEG,
                reading_deg=0.5 + TO_AND_FRO_DEG + error_deg + noise_deg,
                time_s=LASTING_S,
            )
        ]
    )


def orders(r: Responses, *wanted: int) -> list[Candidate]:
    """Orders of the turn, 1 as an eccentricity."""
    waves = [c for c in candidates_of(r) if c.beside is None and c.shape.form == "order of the turn"]
    found = [next(c for c in waves if c.shape.at["order"] == order) for order in wanted if order > 1]
    return [one(r, "stage_eccentricity"), *found] if 1 in wanted else found


def compared(r: Responses, *model: Candidate) -> list[Candidate]:
    """The effects of a model once each has been compared with its competitors."""
    found = [SelectedEffect(candidate, (), 0.001, np.inf) for candidate in model]
    return [f.candidate for f in reselected(r, candidates_of(r), found, 0, thorough=False)]


def test_of_a_series_that_replaces_an_effect_only_the_terms_enter_that_are_needed() -> None:
    """A term without a size would give its place to whatever explains more, untested."""
    sizes_deg = {1: 0.1, 2: 0.5, 4: 0.1, 8: 0.05}
    r = turn_of(sum(a * np.sin(k * TO_AND_FRO + 0.3) for k, a in sizes_deg.items()))
    found = compared(r, one(r, "axis_mismatch", "gain_pct"), one(r, "backlash"))
    terms = [c for c in found if c.shape.series]
    whole = penalised_criterion(r, found)
    assert len(terms) == len(sizes_deg)
    assert all(penalised_criterion(r, [c for c in found if c is not t]) > whole + MARGIN for t in terms)


def test_a_name_leads_before_others_not_before_itself_with_more() -> None:
    r = turn_of(0.002 * LASTING_S)
    more = next(c for c in candidates_of(r) if c.label == "time_drift + mount_slip")
    offered = [one(r, "time_drift"), one(r, "backlash"), more]
    model = fitted_model(r, ())
    ratios = Screen(r, model.columns, offered, model.fitted.noise).once(model.fitted.residuals)
    found = named(r, (), offered, ratios, 0.001)
    behind = dict(found.considered)
    assert (found.candidate.label, found.verdict) == ("time_drift", "named")
    assert found.lead == pytest.approx(behind["backlash"], abs=0.01)
    assert behind[more.label] < 0.5 * found.lead


def test_an_order_of_the_turn_does_not_give_its_place_to_a_drift() -> None:
    wavy = 0.5 * np.sin(TO_AND_FRO) + 0.5 * np.sin(2.0 * TO_AND_FRO) + 0.02 * np.sin(3.0 * TO_AND_FRO)
    r = turn_of(wavy + 0.0002 * LASTING_S)
    assert {c.label for c in compared(r, *orders(r, 1, 2, 3))} <= {"stage_eccentricity", "stage_periodic"}


def test_no_effect_is_replaced_by_one_that_the_others_add_up_to() -> None:
    """A smooth curve over a turn is the orders of the turn once more."""
    bump = 0.2 * np.exp(-(((TO_AND_FRO_DEG - 100.0) / 12.0) ** 2))
    r = turn_of(
        0.3 * np.sin(TO_AND_FRO) + 0.5 * np.sin(2.0 * TO_AND_FRO) + 0.1 * np.sin(4.0 * TO_AND_FRO) + bump
    )
    (short,) = waves(r, 36.8)
    model = [*orders(r, 1, 2, 3, 4, 6, 8), short]
    assert is_admissible(r, model)
    assert is_admissible(r, compared(r, *model))


def test_a_curve_of_many_knots_can_be_true_beside_a_wave() -> None:
    """Its own columns are nearly one another's sum: that says nothing of the two effects."""
    r = turn_of(0.3 * np.exp(-(((TO_AND_FRO_DEG - 100.0) / 25.0) ** 2)) + 0.05 * np.sin(16.0 * TO_AND_FRO))
    assert is_admissible(r, [one(r, "unnamed", "smooth 9"), *orders(r, 16)])


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
