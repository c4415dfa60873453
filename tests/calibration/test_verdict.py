"""Whether a result is good: noise alone is called noise, whatever the number of poses; nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed
from scipy import stats

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import deg_and_limit
from calrig.calibration.uncertainty.verdict import _apart, make_verdict, noise_bound

NOISE_DEG = 0.02


def poses(n, *, seed=0, backlash_deg=0.0, scale=1.002, stderr_deg=NOISE_DEG):
    """Sweeps up and down, with noise that is as large as the poses say."""
    rng = np.random.default_rng(seed)
    theta = np.tile([*range(-60, 61, 10), *range(60, -61, -10)], n // 26 + 1)[:n]
    approach = np.tile([1] * 13 + [-1] * 13, n // 26 + 1)[:n]
    reading = 0.8 + scale * theta + backlash_deg / 2 * approach + rng.normal(0, NOISE_DEG, n)
    return posed(target_deg=theta, reading_deg=reading, approach=approach, reading_stderr_deg=stderr_deg)


def result(n, effects=(), reference=None, **options):
    return build_result(poses(n, **options), None, effects, reference)


def found(name, kind, *, accepted_at=None, rivals=()):
    """A diagnosis with one effect of one parameter."""
    parameters = {f"{name}_deg": {"value": 0.1, "std": 0.01}, "reference_c": {"value": 25.0, "std": None}}
    effect = {"name": name, "verdict": kind, "confusable_with": list(rivals), "parameters": parameters}
    return {"effects": [{**effect, "accepted_at": accepted_at}]}


@pytest.mark.parametrize("freedom", [1, 24, 498, 100_000])
def test_the_limit_is_what_noise_alone_stays_under_in_ninety_nine_of_a_hundred_runs(freedom):
    assert stats.chi2.sf(noise_bound(freedom) ** 2 * freedom, freedom) == pytest.approx(0.01, rel=1e-6)


@pytest.mark.statistical
@pytest.mark.parametrize("n", [4, 26, 104])
def test_noise_alone_is_called_more_than_noise_in_one_run_of_a_hundred(n):
    runs = 1000
    accused = sum(make_verdict(result(n, seed=seed)).left == "more_than_noise" for seed in range(runs))
    assert stats.binomtest(accused, runs, 0.01).pvalue > 1e-3


def test_the_same_ratio_is_noise_of_few_poses_and_more_than_noise_of_many():
    def with_ratio(n):
        one = result(n)
        left = make_verdict(one)
        assert left.left == "noise"
        return one.model_copy(update={"rms_calibrated_deg": one.rms_calibrated_deg * 1.2 / left.ratio})

    few, many = with_ratio(26), with_ratio(520)
    assert (make_verdict(few).left, make_verdict(many).left) == ("noise", "more_than_noise")
    assert make_verdict(few).ratio == pytest.approx(make_verdict(many).ratio)


def test_a_scale_of_the_sensors_changes_nothing():
    assert make_verdict(result(52, scale=0.5)).ratio == pytest.approx(
        make_verdict(result(52, scale=2.0)).ratio
    )


def test_what_is_left_is_judged_after_everything_accepted():
    effects = [("backlash", {"backlash_deg": 0.2})]
    open_one = make_verdict(result(52, backlash_deg=0.2), found("backlash", "named"))
    assert open_one.left == "more_than_noise"
    assert open_one.ratio > 4
    assert any("backlash" in said and "not been accepted" in said for said in open_one.says)
    accepted = make_verdict(
        result(52, effects, backlash_deg=0.2), found("backlash", "named", accepted_at="now")
    )
    assert accepted.left == "noise"
    assert accepted.says[0].startswith("Good")
    assert not any("backlash" in said for said in accepted.says)


def test_an_effect_fitted_to_these_very_poses_takes_its_degree_of_freedom():
    one = result(26, [("backlash", {"backlash_deg": 0.0})])
    elsewhere, here = make_verdict(one), make_verdict(one, found("backlash", "named", accepted_at="now"))
    assert here.ratio / elsewhere.ratio == pytest.approx(
        (24 / 23) ** 0.5
    )  # reference_c was chosen, not fitted


def test_a_verification_fits_nothing():
    one = result(26)
    assert make_verdict(one, verification=True).ratio / make_verdict(one).ratio == pytest.approx(
        (24 / 26) ** 0.5
    )


@pytest.mark.parametrize(
    ("reference", "own", "rival"),
    [
        ({}, "eccentricity of the stage", "backlash of the stage"),
        ({"reference": "stated"}, "eccentricity of the stage", "backlash of the stage"),
        ({"reference": "good"}, "eccentricity of the sensor", "hysteresis of sensor or coupling"),
    ],
)
def test_it_calls_effects_by_their_titles_of_whose_the_error_is(reference, own, rival):
    def says(*effect, rivals=()):
        return make_verdict(result(52, backlash_deg=0.2), {**found(*effect, rivals=rivals), **reference}).says

    named = f"The diagnosis names {own}, which has not been accepted."
    assert named in says("stage_eccentricity", "named")
    ambiguous = f"The diagnosis cannot distinguish {own} from {rival} from the same at another period."
    assert ambiguous in says("stage_eccentricity", "ambiguous", rivals=["backlash", "stage_eccentricity"])


@pytest.mark.parametrize(
    ("diagnosis", "words"),
    [
        (None, ["not been diagnosed"]),
        ({"effects": []}, ["no further effect"]),
        (found("unnamed", "unnamed"), ["not in its catalogue"]),
        (found("backlash", "ambiguous", rivals=["settling"]), ["cannot distinguish", "backlash", "settling"]),
        (
            found("temperature_offset", "ambiguous", rivals=["unnamed"]),
            ["The diagnosis cannot distinguish offset that follows temperature from an unknown effect."],
        ),
    ],
)
def test_it_says_what_is_known_of_the_cause(diagnosis, words):
    says = make_verdict(result(52, backlash_deg=0.2), diagnosis).says
    assert any(all(word in said for word in words) for said in says)


@pytest.mark.parametrize(("std_deg", "explains"), [(0.1, True), (0.02, False)])
def test_a_stage_that_sets_each_pose_anew_may_account_for_it(std_deg, explains):
    one = result(52, reference=Reference(std_deg, "setting"), backlash_deg=0.2)
    judged = make_verdict(one)
    assert judged.left == "more_than_noise"
    assert any("setting uncertainty" in sentence for sentence in judged.says) == explains
    assert any("cause is not known" in sentence for sentence in judged.says) is not explains


@pytest.mark.parametrize(("n", "stderr_deg"), [(26, None), (2, NOISE_DEG), (1, NOISE_DEG)])
def test_without_the_noise_or_poses_to_spare_nothing_is_judged(n, stderr_deg):
    judged = make_verdict(result(n, stderr_deg=stderr_deg))
    assert (judged.left, judged.ratio, judged.answer, judged.limit) == (None, None, "no_limits", None)
    assert judged.says[0].startswith("Not judged")


@pytest.mark.parametrize(
    ("scale", "reference", "differs", "by_the_stage"),
    [(1.0, None, False, False), (1.01, None, True, False), (1.01, Reference(2.0), True, True)],
)
def test_it_says_whether_the_scale_differs_from_one(scale, reference, differs, by_the_stage):
    (said,) = (
        one for one in make_verdict(result(52, scale=scale, reference=reference)).says if "scale" in one
    )
    assert ("standard errors" in said, "stage's own uncertainty" in said) == (differs, by_the_stage)


def test_poses_of_one_elevation_have_no_scale():
    one = build_result([Pose(target_deg=0.0, reading_deg=0.1 * k) for k in range(4)])
    judged = make_verdict(one)
    assert any("one elevation" in said for said in judged.says)
    assert any("only 4 poses" in said for said in judged.says)


@pytest.mark.parametrize(("ratio", "bound"), [(1.2389, 1.2388), (1.23881, 1.2388), (1.2351, 1.2449)])
def test_the_digits_show_which_of_ratio_and_bound_is_larger(ratio, bound):
    first, second = _apart(ratio, bound)
    assert (float(first) > float(second), float(first) == float(second)) == (ratio > bound, False)
    assert _apart(3.0, bound)[0] == "3.00"


@pytest.mark.parametrize(("value", "limit"), [(0.2049, 0.2), (0.19996, 0.2), (0.2, 0.2), (0.2149, 0.215)])
def test_the_digits_show_on_which_side_of_its_limit_an_error_lies(value, limit):
    shown, most = (float(text.partition("°")[0]) for text in deg_and_limit(value, limit))
    assert most == limit
    assert (shown > most, shown == most) == (value > limit, value == limit)
