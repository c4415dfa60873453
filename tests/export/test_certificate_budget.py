"""A certificate's budget: the document's own figures taken apart, the same as GTC has them; and rounding."""

from __future__ import annotations

import math
from dataclasses import replace
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import GTC
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import Limit
from calrig.calibration.uncertainty.verdict import make_verdict
from calrig.export.calibration_document import calibration_content
from calrig.export.certificate import sheet
from calrig.export.certificate.budget import budget_of
from calrig.export.certificate.content import rounded, with_uncertainty
from calrig.export.certificate.making import results_of
from calrig.export.certificate.measured import Measured

HARMONIC = Reference(0.29)
REFERENCES = [
    HARMONIC,
    Reference(0.02, "common", "rectangular"),
    Reference(0.05, "harmonic", "normal"),
    Reference(0.3, "setting"),
]
ENDS = ("highest", "lowest")
RANGES = [(-60.0, 60.0), (5.0, 80.0)]


def calibrated(
    reference: Reference | None, ends: tuple[float, float] = (-60.0, 60.0), n: int = 26
) -> tuple[list[Pose], dict[str, Any]]:
    """Poses of a unit with some noise, and its document."""
    rng = np.random.default_rng(5)
    theta = np.linspace(*ends, n)
    reading = 0.8 + 0.97 * theta + rng.normal(0.0, 0.03, n)
    both = zip(theta.tolist(), reading.tolist(), strict=True)
    poses = [Pose(at_deg, read_deg, reading_stderr_deg=0.03) for at_deg, read_deg in both]
    result = build_result(poses, reference=reference)
    return poses, calibration_content(unit="A", rig="r", poses=poses, result=result, reference=reference)


@pytest.mark.parametrize("ends", RANGES)
@pytest.mark.parametrize("reference", REFERENCES)
def test_the_lines_come_to_what_the_document_says(reference: Reference, ends: tuple[float, float]) -> None:
    _, document = calibrated(reference, ends)
    budget = budget_of(document, reference, 24)
    assert budget.combined_deg == pytest.approx(
        document["expanded_uncertainty_deg"] / document["coverage_factor"]
    )
    assert sum(line.share for line in budget.contributions) == pytest.approx(1.0)
    (of_stage,) = [line for line in budget.contributions if line.type_ == "B"]
    assert of_stage.contribution_deg == pytest.approx(document["uncertainty"]["reference_deg"])


@pytest.mark.parametrize("ends", RANGES)
@pytest.mark.parametrize("reference", REFERENCES)
def test_gtc_has_the_same_budget(reference: Reference, ends: tuple[float, float]) -> None:
    """GTC propagates (reading − bias)/scale, at the two points that are exact for a mean over a range."""
    _, document = calibrated(reference, ends)
    (own, shared), (_, of_scale) = document["covariance"]
    budget = budget_of(document, reference, 24)
    scatter = next(line for line in budget.contributions if line.symbol == "r").std
    middle, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
    squares, of_type_a = [], []
    for theta in (middle - half / math.sqrt(3), middle + half / math.sqrt(3)):
        values = (document["bias_deg"] + document["scale"] * theta, document["bias_deg"], document["scale"])
        reading, bias, scale = GTC.multiple_ureal(values, (scatter, own**0.5, of_scale**0.5), 24)
        GTC.set_correlation(shared / math.sqrt(own * of_scale), bias, scale)
        elevation = (reading - bias) / scale
        of_type_a.append(elevation.v)
        squares.append((elevation + GTC.ureal(0.0, document["uncertainty"]["reference_deg"])).v)
        assert GTC.value(elevation) == pytest.approx(theta)
    assert math.sqrt(sum(squares) / 2) == pytest.approx(budget.combined_deg)
    type_a = GTC.ureal(0.0, math.sqrt(sum(of_type_a) / 2), 24)
    whole = type_a + GTC.ureal(0.0, document["uncertainty"]["reference_deg"])
    assert budget.effective_freedom == pytest.approx(GTC.dof(whole))
    if reference.distribution == "normal" or reference.kind == "setting":
        parts = math.sqrt(sum(of_type_a) / 2), document["uncertainty"]["reference_deg"]
        assert covered_by(document["expanded_uncertainty_deg"], parts, 24) == pytest.approx(0.95, abs=5e-5)


def covered_by(expanded: float, parts: tuple[float, float], freedom: float) -> float:
    """The share within ± expanded: Student's t of type A and a normal type B, convolved by quadrature."""
    type_a, type_b = parts
    above, _ = quad(
        lambda z: norm.pdf(z) * student.sf((expanded - type_b * z) / type_a, freedom),
        -9.0,
        9.0,
        points=[max(-9.0, min(9.0, expanded / type_b))],
        limit=400,
    )
    return float(1.0 - 2.0 * above)


def test_only_documents_of_earlier_programs_have_k_by_welch_and_satterthwaite() -> None:
    reference = Reference(0.05, "harmonic", "normal")
    _, document = calibrated(reference, n=6)
    now = budget_of(document, reference, 4)
    assert "convolved" in now.method[1]
    assert f"{now.effective_freedom:.0f}".split(".", maxsplit=1)[0] in now.method[2]
    by_welch = GTC.reporting.k_factor(now.effective_freedom, 95)
    before = budget_of({**document, "coverage_factor": by_welch}, reference, 4)
    assert len(before.method) == 2
    assert "Satterthwaite" in before.method[1]


@pytest.mark.parametrize("n", [8, 26])
@pytest.mark.parametrize("std_deg", [1e-6, 0.02])
def test_bias_and_scale_have_gtcs_uncertainty_and_a_factor_that_covers(std_deg: float, n: int) -> None:
    reference, freedom = Reference(std_deg, "common", "normal"), n - 2
    poses, document = calibrated(reference, n=n)
    stated = {"std_deg": std_deg, "kind": "common", "distribution": "normal"}
    document = {**document, "provenance": {"rig": {"reference": stated}}}
    run: Any = SimpleNamespace(diagnosis=None)
    budget = budget_of(document, reference, freedom)
    results = results_of(document, run, Measured(poses, document, None, ()), budget, freedom, (), None)
    worth = document["uncertainty"]
    for k, (line, part) in enumerate(zip(results.line, ("bias_deg", "scale"), strict=True)):
        of_poses = GTC.ureal(0.0, math.sqrt(document["covariance"][k][k]), freedom)
        whole = of_poses + GTC.ureal(0.0, worth[f"reference_{part}"])
        assert (line.name, line.std) == (part, pytest.approx(GTC.uncertainty(whole)))
        assert line.expanded == pytest.approx(line.coverage_factor * GTC.uncertainty(whole))
        if of_stage := worth[f"reference_{part}"]:
            parts = GTC.uncertainty(of_poses), of_stage
            assert covered_by(line.expanded, parts, freedom) == pytest.approx(0.95, abs=5e-5)
        else:
            assert line.coverage_factor == pytest.approx(GTC.reporting.k_factor(freedom, 95))


def test_degrees_of_freedom_are_printed_as_the_next_lower_whole_number() -> None:
    """JCGM 100:2008, G.4.1, note 1: an effective ν that is no whole number is truncated."""
    _, document = calibrated(HARMONIC)
    made: Any = SimpleNamespace(budget=replace(budget_of(document, HARMONIC, 24), effective_freedom=23.97))
    _, combined, _ = sheet.budget(made)
    assert ("Effective degrees of freedom", "23") in combined.rows


def test_what_is_not_known_is_said_and_has_no_figure() -> None:
    _, document = calibrated(None)
    budget = budget_of(document, None, 24)
    assert (budget.combined_deg, budget.expanded_deg, budget.coverage_factor) == (None, None, None)
    assert "angle of the stage" in budget.method[0]
    assert any(said.startswith("Level: not known") for said in budget.not_contained)


def test_a_joint_solution_has_its_own_lines() -> None:
    _, document = calibrated(HARMONIC)
    worth = {"type_a_deg": 0.01, "type_b_deg": 0.004, "reference_deg": 0.004}
    over = {"elevation_deg": [-60.0, 60.0], "std_deg": [0.004, 0.004]}
    solved = {**document, "uncertainty": worth, "elevation_std_deg": over}
    budget = budget_of(solved, None, None)
    assert budget.combined_deg == pytest.approx(math.hypot(0.01, 0.004))
    assert [line.type_ for line in budget.contributions] == ["A", "B"]
    assert "joint solution" in budget.contributions[1].title


def test_the_risk_that_a_pass_is_wrong_is_what_many_such_measurements_would_have() -> None:
    """Bias and scale drawn by their covariance, the stage's harmonic as well: within four standard errors."""
    u_deg, allowed_deg, n, freedom = 0.05, 0.13, 100_000, 24
    reference = Reference(u_deg, "harmonic", "normal")
    poses, document = calibrated(reference)
    result = build_result(poses, reference=reference)
    said = make_verdict(result, limit=Limit(name="", max_error_deg=allowed_deg), calibration=document)

    over, rng = result.to_dict()["over_range"], np.random.default_rng(1)
    theta = np.array(over["elevation_deg"])
    line = rng.multivariate_normal([0.0, 0.0], document["covariance"], n)
    line *= np.sqrt(freedom / rng.chisquare(freedom, n))[:, None]
    angle, stage = np.radians(theta), u_deg * rng.normal(size=(n, 2))
    drawn = -(line[:, :1] + line[:, 1:] * theta) / document["scale"]
    drawn += stage[:, :1] * np.sin(angle) + stage[:, 1:] * np.cos(angle)
    over_range = (drawn[:, 1:] + drawn[:, :-1]) / 2 @ np.diff(theta) / np.ptp(theta)
    drawn -= over_range[:, None]  # the level is not known
    highest, lowest = (np.array(over[f"{end}_error_deg"]) - over["mean_error_deg"] for end in ENDS)
    too_high, too_low = drawn + highest > allowed_deg, drawn + lowest < -allowed_deg
    wrong = np.mean((too_high | too_low).any(axis=1))
    assert said.answer == "pass" and said.probability_of_false_accept is not None
    assert 0.005 < wrong < 0.5
    assert abs(said.probability_of_false_accept - wrong) < 4 * math.sqrt(wrong * (1 - wrong) / n)


MANY = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(MANY, st.floats(1e-9, 1e4))
def test_a_value_is_rounded_to_the_second_digit_of_its_uncertainty(value: float, uncertainty: float) -> None:
    said, of_it = with_uncertainty(value, uncertainty)
    assert of_it is not None
    digits = of_it.lstrip("0.").replace(".", "")
    assert len(digits) == 2 or (len(digits) > 2 and set(digits[2:]) == {"0"})
    place = Decimal(1).scaleb(Decimal(of_it).adjusted() - 1)
    assert abs(Decimal(repr(value)) - Decimal(said)) <= place / 2
    assert abs(Decimal(repr(uncertainty)) - Decimal(of_it)) <= place / 2
    assert Decimal(said) % place == 0
    assert "e" not in said.lower() and said != "-0"


@pytest.mark.parametrize(
    ("value", "uncertainty", "expected"),
    [
        (0.80314, 0.0123, ("0.803", "0.012")),
        (1.0, 0.0996, ("1.00", "0.10")),
        (-0.0004, 0.12, ("0.00", "0.12")),
        (1234.5, 123.0, ("1230", "120")),
        (0.123456, None, ("0.1235", None)),
    ],
)
def test_examples_of_rounding(value: float, uncertainty: float | None, expected: tuple[str, Any]) -> None:
    assert with_uncertainty(value, uncertainty) == expected


def test_halves_go_away_from_zero() -> None:
    assert (rounded(0.125, -2), rounded(-0.125, -2), rounded(2.5, 0)) == ("0.13", "-0.13", "3")
