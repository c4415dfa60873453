"""Whether a diagnosis is good news: a name is, where the error on poses it has not seen falls with it."""

from __future__ import annotations

import pytest

from calrig.calibration.diagnosis_verdict import diagnosis_verdict

NO_NAME = {"name": "unnamed", "verdict": "unnamed", "covariate": "time_s", "confusable_with": []}


def effect(name, verdict="named", *rivals):
    return {"name": name, "verdict": verdict, "covariate": "approach", "confusable_with": list(rivals)}


def found(verdict, *effects, before_deg=0.1, after_deg=0.02, fresh_deg=None):
    """A diagnosis; `fresh_deg` are the errors before and after on a fresh run."""
    fresh = fresh_deg and {"run_id": "9", "before_rms_deg": fresh_deg[0], "after_rms_deg": fresh_deg[1]}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "base": {"held_out_rms_deg": before_deg},
        "final": {"held_out_rms_deg": after_deg},
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
        (found("ambiguous", effect("backlash", "ambiguous", "settling")), "fair"),
        (found("unnamed", NO_NAME), "fair"),
    ],
)
def test_a_name_is_good_news_where_the_error_on_held_out_poses_falls(diagnosis, grade):
    assert diagnosis_verdict(diagnosis).grade == grade


def test_the_answer_names_what_was_found_the_weakest_first():
    several = (effect("backlash", "ambiguous", "settling"), NO_NAME, effect("time_drift"))
    assert diagnosis_verdict(found("ambiguous", *several)).says == (
        "Indistinguishable by these poses: backlash or settling. "
        "Not in the catalogue: something that follows time. Identified: drift in time",
    )


def test_an_error_that_has_not_fallen_or_is_not_known_is_said():
    (_, same) = diagnosis_verdict(found("named", effect("backlash"), after_deg=0.1)).says
    assert same.startswith("The error on held-out poses has not decreased")
    (_, unknown) = diagnosis_verdict(found("named", effect("backlash"), after_deg=None)).says
    assert unknown.startswith("Without cross-validation")


def test_a_confirmation_says_on_how_many_other_poses_it_was_decided():
    fresh = found("named", effect("backlash"), fresh_deg=(0.1, 0.02))
    (_, confirmed) = diagnosis_verdict(fresh, decided=1).says
    assert confirmed == (
        "Confirmed on poses of run 9 that were not used for the decision (1 pose decided): "
        "RMS 0.100° before and 0.0200° after."
    )
