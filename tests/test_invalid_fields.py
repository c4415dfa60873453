"""What is wrong with an input is told in the page's own words, by the name that its field has there."""

from __future__ import annotations

import re
from typing import Literal

import pytest
from pydantic import TypeAdapter, ValidationError

from calrig.api.models import StartRun
from calrig.invalid_fields import COMMON, SHOWN, in_words, path_of, sentence
from calrig.plan import Plan, Until
from calrig.settings import LimitSettings, packed


def problems(kind, given):
    with pytest.raises(ValidationError) as raised:
        TypeAdapter(kind).validate_python(given)
    return raised.value.errors()


@pytest.mark.parametrize(
    ("given", "said", "path"),
    [
        ({"elevations_deg": [0, "ten"]}, "Elevation 2 is not a number", "elevations_deg[1]"),
        ({"elevations_deg": []}, "Elevations has 0 entries, fewer than 1", "elevations_deg"),
        ({"sweeps": 1.5}, "Sweeps is not a whole number", "sweeps"),
        ({"sweeps": 0}, "Sweeps must be at least 1", "sweeps"),
        ({"step_deg": 0}, "Step must be greater than 0", "step_deg"),
        ({"dwell_s": float("nan")}, "Dwell time is not a finite number", "dwell_s"),
        ({"order": "backwards"}, "Order is none of 'sweep', 'random' or 'given'", "order"),
        ({"sweep": 3}, "“sweep” is not known here", "sweep"),
        ({"sweeps": 9999}, "the plan has 129987 poses; the most a run takes is 10000", ""),
    ],
)
def test_a_plans_mistake_is_told_by_the_name_of_its_field(given, said, path):
    (problem,) = problems(Plan, given)
    assert (sentence(problem, Plan), path_of(problem)) == (said, path)


def test_a_limits_mistake_says_which_limit():
    given = [{"name": "a", "rms_deg": 1.0}, {"name": "b", "rms_deg": "small"}]
    (problem,) = problems(list[LimitSettings], given)
    assert (sentence(problem, list[LimitSettings]), path_of(problem)) == (
        "RMS error of limit 2 is not a number",
        "[1].rms_deg",
    )


@pytest.mark.parametrize(
    ("kind", "given", "said"),
    [
        (Plan, [], "The body is not an object"),
        (list[LimitSettings], [{"name": "a", "bias_deg": [1]}], "Entry 2 of bias of limit 1 is missing"),
        (Literal["json", "pdf"] | Literal["c"], "x", "The body is none of 'json', 'pdf', 'c'"),
    ],
)
def test_what_is_wrong_is_told_without_the_words_of_a_program(kind, given, said):
    assert in_words(problems(kind, given), kind) == said


def test_one_name_in_two_models_has_two_titles():
    wanted = {"expanded_uncertainty_deg": -1.0}
    until, limits = StartRun, list[LimitSettings]
    (of_until,) = problems(until, {"unit": "AS-1", "plan": {"until": wanted}})
    (of_limit,) = problems(limits, [{"name": "a", **wanted}])
    assert sentence(of_until, until) == "Stop at expanded uncertainty must be greater than 0"
    assert sentence(of_limit, limits) == "Expanded uncertainty of limit 1 must be greater than 0"


def test_of_many_mistakes_the_first_few_are_told_and_the_others_counted():
    wrong = dict.fromkeys(["sweeps", "settle_s", "dwell_s", "rate_hz", "seed"], "x")
    assert in_words(problems(Plan, wrong)).endswith("; and 2 more")
    assert in_words(problems(Plan, wrong)).count("; ") == SHOWN


def test_the_names_are_those_of_the_page():
    """`spec("sweeps", "Sweeps", …)` in the form of the plan; what follows a comma tells its use."""
    form = (packed("web") / "plan.js").read_text()
    shown = dict(re.findall(r'(?:spec|field)\("(\w+)", "([^",]+)', form))
    assert len(shown) >= 10
    titles = {**COMMON, **Until.TITLES, **Plan.TITLES}
    assert {name: titles[name] for name in shown} == shown
