"""What a diagnosis concludes: a name is good news if the error on held-out poses falls with it."""

from __future__ import annotations

import re

import pytest

from calrig.calibration.diagnosis.conclusion import conclude

NO_NAME = {"name": "unnamed", "verdict": "unnamed", "covariate": "time_s", "confusable_with": []}


def effect(name, verdict="named", *rivals):
    return {"name": name, "verdict": verdict, "covariate": "approach", "confusable_with": list(rivals)}


def noise(times=1.0, *, rejected=False, pure_error_deg=0.02):
    """A residual of so many times the pure error, None where that is not known."""
    known = pure_error_deg is not None
    return {
        "std_deg": times * (pure_error_deg or 0.02),
        "lag1_correlation": 0.93,
        "pure_error_deg": pure_error_deg,
        "lack_of_fit": {"rejected": rejected, "freedom": [24.0, 1e4]} if known else None,
    }


def found(
    verdict,
    *effects,
    before_deg=0.1,
    after_deg=0.02,
    blocked_deg=(None, None),
    fresh_deg=None,
    left=None,
    fit_deg=None,
):
    """A diagnosis of 26 poses; `blocked_deg`, `fresh_deg`: errors before and after on blocks and a fresh run.

    `fit_deg` is the residual of all poses, where single ones are far off.
    """
    fresh = fresh_deg and {"run_id": "9", "before_rms_deg": fresh_deg[0], "after_rms_deg": fresh_deg[1]}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "noise": left or noise(),
        "base": {"held_out_rms_deg": before_deg, "blocked_rms_deg": blocked_deg[0]},
        "final": {
            "fit_rms_deg": fit_deg or (left or noise())["std_deg"],
            "held_out_rms_deg": after_deg,
            "blocked_rms_deg": blocked_deg[1],
        },
        "n_poses": 26,
        "confirmed_by": fresh,
    }


@pytest.mark.parametrize(
    ("diagnosis", "grade"),
    [
        (found("nothing", after_deg=0.1), "unknown"),
        (found("named", effect("backlash")), "good"),
        (found("named", effect("backlash"), after_deg=None), "good"),
        (found("named", effect("backlash"), fresh_deg=(0.1, 0.02)), "good"),
        (found("named", effect("backlash"), fresh_deg=(0.1, 0.11)), "fair"),
        (found("named", effect("backlash"), after_deg=0.1), "fair"),
        (found("named", effect("time_drift"), blocked_deg=(0.1, 0.03)), "good"),
        (found("named", effect("time_drift"), blocked_deg=(0.1, 0.2)), "fair"),
        (found("named", effect("backlash"), left=noise(4.0, rejected=True)), "fair"),
        (found("named", effect("backlash"), left=noise(1.3, rejected=True)), "good"),
        (found("ambiguous", effect("backlash", "ambiguous", "settling")), "fair"),
        (found("unnamed", NO_NAME), "fair"),
    ],
)
def test_a_name_is_good_news_where_the_error_on_held_out_poses_falls(diagnosis, grade):
    assert conclude(diagnosis).grade == grade


def test_the_answer_names_what_was_found_the_weakest_first():
    several = (effect("backlash", "ambiguous", "settling"), NO_NAME, effect("time_drift"))
    said = conclude(found("ambiguous", *several)).says[0]
    parts = [
        ("Indistinguishable", "backlash of the stage or incomplete settling"),
        ("Not in the catalogue", "follows time"),
        ("Identified", "drift in time"),
    ]
    found_parts = said.split(". ")
    assert len(found_parts) == len(parts)
    assert all(what in part and which in part for (what, which), part in zip(parts, found_parts, strict=True))


def test_a_candidate_without_a_name_is_an_unknown_effect():
    said = conclude(found("ambiguous", effect("temperature_offset", "ambiguous", "unnamed"))).says[0]
    assert said.endswith("offset that follows temperature or an unknown effect")


def test_with_a_good_reference_every_effect_and_rival_has_the_words_for_it():
    several = (effect("time_drift", "ambiguous", "stage_eccentricity"), effect("backlash"))
    diagnosis = found("ambiguous", *several)
    assert conclude(diagnosis).says[0].count("of the stage") == 2
    said = conclude(diagnosis | {"reference": "good"}).says[0]
    assert "drift in time or eccentricity of the sensor" in said
    assert "stage" not in said


def answer(left):
    return conclude(found("nothing", after_deg=0.1, left=left)).says[0]


def test_nothing_found_is_noise_only_where_the_pure_error_allows_it():
    assert "consistent with noise" in answer(noise(1.1))
    rejected = answer(noise(3.8, rejected=True))
    assert "consistent with noise" not in rejected
    assert all(figure in rejected for figure in ("0.0760°", "3.8 times", "0.93"))
    unknown = answer(noise(pure_error_deg=None))
    assert "consistent with noise" not in unknown
    assert "neither dwells nor revisited poses" in unknown


def test_a_residual_that_single_poses_make_large_is_not_called_noise():
    """Seen in a run of 13 poses: the verdict said 2.75 times the noise, the diagnosis called it noise."""
    said = conclude(found("nothing", left=noise(1.1), fit_deg=0.05)).says[0]
    assert "consistent with noise" not in said
    assert all(figure in said for figure in ("0.0500°", "2.5 times"))
    assert "consistent with noise" in conclude(found("nothing", left=noise(1.1), fit_deg=0.025)).says[0]


def test_what_poses_repeat_to_is_not_called_the_noise_of_their_dwells():
    """The run's verdict, by the dwells, says that more than noise is left: so must this, and why."""
    tested = {"rejected": False, "freedom": [34.0, 26.0]}
    restless = {**noise(1.05), "floor_deg": 0.003, "lack_of_fit": tested}
    assert "consistent with noise" not in answer(restless)
    assert all(figure in answer(restless) for figure in ("0.0210°", "7.0 times"))
    assert "consistent with noise" in answer({**restless, "floor_deg": 0.02})


def test_what_effects_do_not_explain_is_said_beside_their_names():
    left = noise(4.0, rejected=True)
    (_, rest, _) = conclude(found("named", effect("backlash"), left=left)).says
    assert all(figure in rest for figure in ("0.0800°", "4.0 times"))


@pytest.mark.parametrize(
    ("blocked_deg", "figures", "in_blocks"),
    [
        ((None, None), ["0.100°", "0.0200°"], False),
        ((0.1, 0.01), ["0.100°", "0.0200°"], False),
        ((0.1, 0.05), ["0.100°", "0.0500°"], True),
        ((0.1, 0.3), ["0.100°", "0.0200°", "0.100°", "0.300°"], True),
    ],
)
def test_the_claim_rests_on_the_folds_that_the_effects_help_less(blocked_deg, figures, in_blocks):
    said = conclude(found("named", effect("time_drift"), blocked_deg=blocked_deg)).says[1]
    assert re.findall(r"[\d.]+°", said) == figures
    assert ("blocks" in said) == in_blocks


def test_an_error_that_has_not_fallen_or_is_not_known_is_said():
    (_, same) = conclude(found("named", effect("backlash"), after_deg=0.1)).says
    assert "not decreased" in same
    (_, unknown) = conclude(found("named", effect("backlash"), after_deg=None)).says
    assert "cross-validation" in unknown


def test_a_confirmation_says_on_how_many_other_poses_it_was_decided():
    fresh = found("named", effect("backlash"), fresh_deg=(0.1, 0.02))
    (_, _, confirmed) = conclude(fresh, decided=1).says
    assert confirmed.startswith("Confirmed")
    assert all(word in confirmed for word in ("run 9", "1 pose ", "0.100°", "0.0200°"))
