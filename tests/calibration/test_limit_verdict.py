"""A result against limits: what is decided, by how much, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from posed import posed

from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import apply_calibration, build_result
from calrig.calibration.uncertainty.budget import Reference, ReferenceFigures
from calrig.calibration.uncertainty.conformity import Limit
from calrig.calibration.uncertainty.verdict import make_verdict, verdict_figures
from calrig.settings import LimitSettings

STAGE = Reference(0.029, "harmonic")  # a limit of ±0.05°: U = 0.048° alone
NOISE_DEG = 0.005


def poses(n=52, scale=1.002, bias_deg=0.8, bent_deg=0.0, seed=0):
    rng = np.random.default_rng(seed)
    theta = np.tile([*range(-60, 61, 10), *range(60, -61, -10)], n // 26 + 1)[:n]
    reading = (
        bias_deg + scale * theta + bent_deg * np.cos(np.radians(6.0 * theta)) + rng.normal(0, NOISE_DEG, n)
    )
    return posed(target_deg=theta, reading_deg=reading, reading_stderr_deg=NOISE_DEG)


def judged(reference=STAGE, calibration=None, move_mismatches=0, *, of=None, **asked):
    result = build_result(of or poses(), None, (), reference)
    limit = Limit(name="flight", **asked)
    return make_verdict(result, limit=limit, calibration=calibration, move_mismatches=move_mismatches)


def known_level(of=None, reference=STAGE):
    """Of section 6's document, what a limit looks at, with the level known."""
    over = build_result(of or poses(), None, (), reference).to_dict()["over_range"]
    return {**over, "level_known": True}


@pytest.mark.parametrize(
    ("bent_deg", "answer"),
    [(0.0, "pass"), (0.08, "conditional_pass"), (0.12, "conditional_fail"), (0.4, "fail")],
)
def test_the_largest_error_is_what_is_left_and_the_answer_one_of_four(bent_deg, answer):
    """0.12° allowed: bent by so much at 0°, ±60° and against it at ±30°. U is 0.05°, and half of the bend."""
    one = judged(of=poses(bent_deg=bent_deg), max_error_deg=0.12, rule="guarded")
    assert (one.answer, one.limit) == (answer, "flight")
    assert all(word in one.says[0] for word in ("flight", "guarded", "w = 1·U"))
    assert "Largest error" in one.says[1]
    assert "−60° to 60°" in one.says[1]


def test_a_pass_says_its_own_risk_and_only_a_pass_does():
    one = judged(max_error_deg=0.07)
    assert one.answer == "pass"
    assert one.probability_of_false_accept == pytest.approx(1.0 - one.probability_of_conformity)
    assert 0.9 < one.probability_of_conformity <= 1.0
    assert any("false acceptance" in said for said in one.says)
    failed = judged(of=poses(bent_deg=0.2), max_error_deg=0.12)
    assert (failed.answer, failed.probability_of_false_accept) == ("fail", None)
    assert failed.probability_of_conformity < 0.01
    assert not any("false acceptance" in said for said in failed.says)


def test_a_bias_is_not_decided_while_the_level_is_not_known():
    """Clamped askew by twice what is allowed, and still nobody can say so: neither a pass nor a fail."""
    one = judged(bias_deg=(-0.4, 0.4), scale=(0.99, 1.01))
    assert one.answer == "undecided"
    assert any(said.startswith("Bias 0.80°: not decided") for said in one.says)
    assert any("Scale 1.00198" in said and said.endswith(": pass.") for said in one.says)
    assert one.probability_of_conformity > 0.99  # of what can be decided


@pytest.mark.parametrize(("bias_deg", "answer"), [(0.8, "fail"), (0.2, "pass")])
def test_with_the_level_known_it_is(bias_deg, answer):
    of = poses(bias_deg=bias_deg)
    assert judged(of=of, calibration=known_level(of), bias_deg=(-0.4, 0.4)).answer == answer


def test_the_document_goes_before_the_result():
    """A solution of stage and units together knows a scale better, and finds another one."""
    other = {**known_level(), "scale": 1.02}
    assert judged(scale=(0.99, 1.01)).answer == "pass"
    assert judged(scale=(0.99, 1.01), calibration=other).answer == "fail"


@pytest.mark.parametrize("rule", ["simple", "guarded"])
@pytest.mark.parametrize("asked", [{"max_error_deg": 9.0}, {"scale": (0.5, 1.5)}, {"rms_deg": 9.0}])
def test_without_a_reference_nothing_passes(rule, asked):
    one = judged(None, rule=rule, **asked)
    assert (one.answer, one.probability_of_conformity) == ("undecided", None)
    assert any("probable" in said and "not known" in said for said in one.says)


def test_an_expanded_uncertainty_that_is_too_large_fails_however_good_the_unit():
    one = judged(max_error_deg=1.0, expanded_uncertainty_deg=0.04)
    assert (one.answer, one.probability_of_conformity) == ("fail", 0.0)
    assert any("0.040°" in said and "fail" in said for said in one.says)


def test_an_rms_is_held_with_its_own_uncertainty():
    assert judged(rms_deg=0.0052).answer == "pass"
    assert judged(rms_deg=0.0052, rule="guarded").answer == "conditional_pass"
    assert judged(rms_deg=0.0080, rule="guarded").answer == "pass"


def figures(result):
    return verdict_figures(result, None, verification=False, move_mismatches=0)


def test_the_uncertainty_of_an_rms_is_that_of_as_many_residuals_drawn_again():
    result = build_result(poses(), None, (), STAGE)
    one, freedom = figures(result), result.n_poses - 2
    residuals = np.random.default_rng(0).normal(0.0, one.rms_deg, (20_000, freedom))
    drawn_deg = np.sqrt((residuals**2).mean(axis=1))
    assert one.rms_expanded_deg == pytest.approx(1.96 * drawn_deg.std(), rel=0.02)


def test_the_uncertainty_of_bias_and_scale_has_the_stages_part_in_it():
    """By lines through many stages: an axis off its scale's centre, either way by a normal error."""
    of, std_deg = poses(n=520), 0.1
    result = build_result(of, None, (), Reference(std_deg, "harmonic", "normal"))
    one = figures(result)
    theta = np.array([pose.target_deg for pose in of])
    off = np.random.default_rng(1).normal(0.0, std_deg, (2, 20_000))
    stage_deg = np.sin(np.radians(theta))[:, None] * off[0] + np.cos(np.radians(theta))[:, None] * off[1]
    slopes, levels = np.polyfit(theta, stage_deg, 1)
    assert one.scale_expanded == pytest.approx(1.96 * np.hypot(result.scale_std, slopes.std()), rel=0.03)
    assert one.bias_deg is None  # while the level is unknown
    assert one.bias_expanded_deg == pytest.approx(
        1.96 * np.hypot(result.bias_std_deg, levels.std()), rel=0.03
    )


def test_a_larger_uncertainty_of_an_elevation_does_not_widen_that_of_the_errors():
    calibration = {**known_level(), "expanded_uncertainty_deg": 1.0}
    assert judged(calibration=calibration, max_error_deg=0.08, rule="guarded").answer == "pass"


def test_the_worst_figure_is_the_answer():
    assert judged(of=poses(bent_deg=0.2), max_error_deg=0.12, scale=(0.5, 1.5)).answer == "fail"


def test_what_is_not_to_be_relied_on_does_not_pass():
    one = judged(max_error_deg=1.0, move_mismatches=2)
    assert (one.answer, one.reliable) == ("undecided", False)
    assert one.says[0].startswith("Not to be relied on")


def test_what_fails_fails_however_doubtful_it_is():
    one = judged(of=poses(bent_deg=0.2), max_error_deg=0.12, move_mismatches=2)
    assert (one.answer, one.reliable) == ("fail", False)


def test_a_result_of_an_earlier_version_is_not_decided():
    result = build_result(poses(), None, (), STAGE).model_copy(update={"over_range": None})
    one = make_verdict(result, limit=Limit(name="flight", max_error_deg=1.0))
    assert one.answer == "undecided"
    assert any("earlier version" in said for said in one.says)


def test_a_reading_that_does_not_follow_the_stage_fails():
    stuck = [Pose(target_deg=t, reading_deg=0.0) for t in (-30.0, 0.0, 30.0)]
    assert judged(of=stuck, max_error_deg=1.0).answer == "fail"


def verified(at_deg, elevations_deg=(20.0,) * 6, stated=STAGE):
    """A verification of poses that read so much too high once a perfect calibration is applied."""
    rng = np.random.default_rng(1)
    there = [t + rng.normal(0, 1e-3) for t in elevations_deg]  # as a stage reports it
    of = [
        Pose(target_deg=t, stage_deg=s, reading_deg=s + at_deg, reading_stderr_deg=NOISE_DEG)
        for t, s in zip(elevations_deg, there, strict=True)
    ]
    figures = ReferenceFigures(
        std_deg=stated.std_deg,
        kind=stated.kind,
        bias_std_deg=stated.std_deg,
        scale_std=0.001,
        distribution=stated.distribution,
    )
    line = Line(0.0, 1.0, 0.001, 1e-5, None, None)
    return apply_calibration(of, None, line, (), figures)


def test_a_verification_is_held_as_found_against_the_document():
    """The same shift everywhere may be the clamping's; a fan of errors is the unit's."""
    limit = Limit(name="flight", max_error_deg=0.1, scale=(0.5, 1.5))
    everywhere = tuple(range(-60, 61, 10))
    shifted = make_verdict(verified(0.3, everywhere), verification=True, limit=limit)
    assert (shifted.answer, shifted.left) == ("pass", "more_than_noise")
    fanned = verified(0.0, everywhere)
    *rest, _ = fanned.over_range.highest_error_deg
    over = replace(fanned.over_range, highest_error_deg=(*rest, 0.2))
    fanned = fanned.model_copy(update={"over_range": over})
    assert make_verdict(fanned, verification=True, limit=limit).answer == "fail"


def test_at_one_elevation_nothing_is_relative_to_the_others():
    one = make_verdict(
        verified(0.3), verification=True, limit=Limit(name="flight", max_error_deg=0.1, scale=(0.5, 1.5))
    )
    assert one.answer == "undecided"
    assert any(said.startswith("Largest error: not decided") for said in one.says)
    assert any(said.startswith("Scale: not decided") for said in one.says)


def test_a_verdict_is_json():
    one = judged(max_error_deg=0.07).to_dict()
    assert list(one) == [
        "answer",
        "left",
        "ratio",
        "says",
        "limit",
        "probability_of_conformity",
        "probability_of_false_accept",
        "reliable",
    ]
    assert isinstance(one["says"], list)


POSITIVE = st.none() | st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
ENDS = st.none() | st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 2).map(sorted)
ASKED = {
    "max_error_deg": POSITIVE,
    "bias_deg": ENDS,
    "scale": ENDS,
    "rms_deg": POSITIVE,
    "expanded_uncertainty_deg": POSITIVE,
    "rule": st.sampled_from(["simple", "guarded"]),
    "guard": st.floats(min_value=0.0, exclude_min=True, max_value=10.0),
}
RESULTS = [build_result(poses(), None, (), reference) for reference in (STAGE, None)]


@settings(max_examples=60)
@given(st.fixed_dictionaries(ASKED))
@example({"rms_deg": 1e-300})
@example(
    {"rms_deg": 1e308, "max_error_deg": 5e-324, "scale": (-1e308, 1e308), "rule": "guarded", "guard": 10.0}
)
def test_whatever_can_be_asked_is_answered(asked):
    try:
        limit = Limit(**LimitSettings(name="any", **asked).model_dump())
    except ValueError:
        return  # the lower end is not below the upper one, or nothing is asked
    known, unknown = (make_verdict(result, limit=limit) for result in RESULTS)
    assert {known.answer, unknown.answer} <= {
        "pass",
        "conditional_pass",
        "conditional_fail",
        "fail",
        "undecided",
    }
    assert unknown.answer != "pass"
    assert unknown.probability_of_conformity is None
    assert (known.probability_of_false_accept is None) == (known.answer != "pass")
    assert known.probability_of_conformity is None or 0.0 <= known.probability_of_conformity <= 1.0
    assert not any("nan" in said or "inf°" in said for said in known.says)
