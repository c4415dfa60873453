"""Limits and decision rules: four answers, what they cost, and what no unit can pass."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import Limit, beyond_interval, cannot_pass, decide, limit_for

THETA_DEG = np.tile(np.arange(-60.0, 61.0, 10.0), 4)


def guarded(guard=1.0, **asked):
    return Limit(name="guarded", rule="guarded", guard=guard, **asked)


def test_the_first_limit_that_matches_a_unit_counts():
    limits = [
        Limit(name="flight", units="AS-*", rig="bench-1"),
        Limit(name="all of them", units="AS-*"),
        Limit(name="one", units="X-0?"),
    ]

    def name(unit, rig):
        found = limit_for(limits, unit, rig)
        return found and found.name

    assert name("AS-0042", "bench-1") == "flight"
    assert name("AS-0042", "bench-2") == name("AS-0042", None) == "all of them"
    assert name("X-07", None) == "one"
    assert (name("X-007", None), name("as-0042", "bench-1")) == (None, None)


def test_a_limit_comes_back_from_its_json():
    limit = Limit(
        name="all", units="AS-*", bias_deg=(-1.0, 1.0), max_error_deg=0.5, rule="guarded", guard=0.5
    )
    assert Limit.model_validate(limit.model_dump(mode="json")) == limit
    assert limit.model_dump(mode="json")["bias_deg"] == [-1.0, 1.0]


@pytest.mark.parametrize(
    ("value", "simple", "with_guard"),
    [
        (0.30, "pass", "pass"),
        (0.40, "pass", "pass"),
        (0.41, "pass", "conditional_pass"),
        (0.50, "pass", "conditional_pass"),
        (0.51, "fail", "conditional_fail"),
        (0.60, "fail", "conditional_fail"),
        (0.61, "fail", "fail"),
    ],
)
def test_the_guarded_rule_has_four_answers_and_the_simple_one_two(value, simple, with_guard):
    """0.5° allowed, U = 0.1°; just on a bound counts as the better side, to a hair of arithmetic."""
    beyond_deg = round(value - 0.5, 9)
    assert decide(Limit(name="simple"), beyond_deg, 0.1) == simple
    assert decide(guarded(), beyond_deg, 0.1) == with_guard


@pytest.mark.parametrize("rule", ["simple", "guarded"])
@pytest.mark.parametrize("value", [-10.0, -0.1, 0.0, 0.1, 10.0])
def test_nothing_passes_whose_uncertainty_is_not_known(rule, value):
    assert decide(Limit(name="any", rule=rule), value, None) != "pass"
    assert decide(Limit(name="any", rule=rule), value, 0.1, known=False) != "pass"


def test_of_an_interval_the_nearer_end_counts():
    assert [beyond_interval(value, (-1.0, 2.0)) for value in (0.0, 1.5, -1.25, 3.0)] == [
        -1.0,
        -0.5,
        0.25,
        1.0,
    ]


def risks(limit, tur):
    """Of false acceptance and of false rejection, by the rule itself, over all units there are.

    Units are normal with 95 % of them within ± 1, measured with a normal error of 2u = U = 1/tur: the usual
    case of a bench (JCGM 106:2012, 9.5).
    """
    expanded = 1.0 / tur
    measured = np.linspace(0.0, 1.5, 15001)
    passing = [m for m in measured if decide(limit, round(m - 1.0, 9), expanded) == "pass"]
    edge = max(passing, default=0.0)

    def joint(unit, *, passed):
        passes = norm.cdf(edge, unit, expanded / 2.0) - norm.cdf(-edge, unit, expanded / 2.0)
        return norm.pdf(unit, scale=1.0 / 1.96) * (passes if passed else 1.0 - passes)

    false_accept = 2.0 * quad(lambda unit: joint(unit, passed=True), 1.0, 4.0)[0]
    return false_accept, 2.0 * quad(lambda unit: joint(unit, passed=False), 0.0, 1.0)[0]


def test_a_guard_band_of_u_buys_few_false_acceptances_with_many_false_rejections():
    """At a test uncertainty ratio of 4, false accepts 0.86 → 0.02 %, false rejects 1.55 → 10.4 %."""
    false_accept, false_reject = risks(Limit(name="simple"), 4.0)
    assert (false_accept, false_reject) == (pytest.approx(0.0086, abs=1e-4), pytest.approx(0.0155, abs=1e-4))
    false_accept, false_reject = risks(guarded(), 4.0)
    assert (false_accept, false_reject) == (pytest.approx(0.0002, abs=2e-5), pytest.approx(0.104, abs=1e-3))


def test_a_worse_stage_costs_more_of_both_and_at_a_ratio_of_one_a_full_guard_passes_nothing():
    accepts, rejects = zip(*(risks(Limit(name="simple"), tur) for tur in (4.0, 1.5, 1.0)), strict=True)
    assert list(accepts) == sorted(accepts)
    assert list(rejects) == sorted(rejects)
    assert risks(guarded(), 1.5)[1] > 0.5
    false_accept, false_reject = risks(guarded(), 1.0)
    assert (false_accept, false_reject) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.95, abs=1e-3))


@pytest.mark.parametrize(
    ("tur", "rss", "dobbert"), [(4.0, 0.968, 0.987), (2.5, 0.917, 0.914), (1.5, 0.745, 0.760)]
)
def test_narrower_guards_are_those_of_the_literature(tur, rss, dobbert):
    """Band factors, acceptance limit over L, as guards w = guard·U (table: docs/reference/conformity.md)."""
    for factor, guard in (
        (rss, tur - math.sqrt(tur**2 - 1.0)),
        (dobbert, 1.04 - math.exp(0.38 * math.log(tur) - 0.54)),
    ):
        limit = guarded(guard)
        assert decide(limit, factor - 1e-3 - 1.0, 1.0 / tur) == "pass"
        assert decide(limit, factor + 1e-3 - 1.0, 1.0 / tur) == "conditional_pass"


STAGE = Reference(0.29)  # a limit of half a degree: U = 0.48° alone


@pytest.mark.parametrize(
    ("limit", "reference", "why"),
    [
        (guarded(max_error_deg=0.4), STAGE, "w = 1·U with U = 0.48° of the stage alone"),
        (guarded(scale=(0.999, 1.001)), STAGE, "allowed to the scale"),
        (Limit(name="u", expanded_uncertainty_deg=0.4), STAGE, "more than the 0.40° allowed"),
        (Limit(name="bias", bias_deg=(-1.0, 1.0)), STAGE, "the level is not known"),
        (Limit(name="any", max_error_deg=5.0), None, "`reference`"),
    ],
)
def test_what_no_unit_can_pass_on_a_stage_is_said_before_it_moves(limit, reference, why):
    (said,) = cannot_pass(limit, reference, THETA_DEG)
    assert said.startswith("No unit can pass on this stage")
    assert why in said


@pytest.mark.parametrize(
    ("limit", "reference"),
    [
        (guarded(max_error_deg=0.5), STAGE),
        (guarded(0.5, max_error_deg=0.4), STAGE),
        (Limit(name="simple", max_error_deg=0.1), STAGE),
        (guarded(max_error_deg=0.4), Reference(0.29, "setting")),
        (guarded(scale=(0.99, 1.01)), STAGE),
    ],
)
def test_what_some_unit_can_pass_is_not_said(limit, reference):
    assert cannot_pass(limit, reference, THETA_DEG) == []


@pytest.mark.parametrize(("share", "can_pass"), [(0.99, False), (1.01, True)])
def test_the_room_of_a_scale_is_half_its_interval(share, can_pass):
    """The harmonic error's slope by numpy's polyfit: of a symmetric range that of the sine alone."""
    symmetric_deg = np.linspace(-60.0, 60.0, 25)
    slope = np.polyfit(symmetric_deg, np.sin(np.radians(symmetric_deg)), 1)[0]
    expanded = 0.95 * np.sqrt(3.0) * 0.29 * slope
    limit = guarded(scale=(1.0 - share * expanded, 1.0 + share * expanded))
    assert (cannot_pass(limit, STAGE, symmetric_deg) == []) is can_pass
