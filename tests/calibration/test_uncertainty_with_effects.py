"""What is stated of an elevation with effects taken out, against its errors at angles not measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from calrig.calibration.diagnosis import RunOfEffects, fit_together
from calrig.calibration.poses import Pose
from calrig.calibration.results import build_result
from calrig.calibration.results.correction import Application
from calrig.calibration.uncertainty.budget import Reference
from calrig.export.calibration_document import calibration_content
from calrig.export.certificate.budget import budget_of
from calrig.store.records import AcceptedEffect, as_applied, doubt_of

NOISE_DEG, SEEDS = 0.03, 40
GOOD = Reference(1e-9)
Effects = list[tuple[str, dict[str, float]]]


class Unit(NamedTuple):
    """Targets, the unit's own error at an angle and a temperature, and the effects that describe it."""

    target_deg: np.ndarray
    error_deg: Callable[[np.ndarray, np.ndarray], np.ndarray]
    effects: Effects


def wave(amplitude_deg: float, order: float = 1.0, phase_deg: float = 30.0) -> Callable[..., np.ndarray]:
    return lambda theta, _: amplitude_deg * np.sin(np.radians(order * theta + phase_deg))


def curve(theta: np.ndarray, _: np.ndarray) -> np.ndarray:
    return 1e-4 * theta**2 - 1e-6 * theta**3


def two_that_cancel(theta: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """Together at most 0.5° of an arc sine's curve, of which each alone is 33°."""
    return 7e-4 * theta**2 - 3.5e-5 * theta**3 + wave(33.7, phase_deg=172.0)(theta, celsius)


ORDER_3 = {"amplitude_deg": 0.2, "phase_deg": 30.0, "period_deg": 120.0}
ECCENTRICITY = ("stage_eccentricity", {"amplitude_deg": 1.0, "phase_deg": 30.0})
NONLINEARITY = ("nonlinearity", {"deg_per_deg2": 1e-4, "deg_per_deg3": -1e-6})
WARMTH = ("temperature_bias", {"deg_per_c": 0.02, "reference_c": 20.0})
ARC = np.arange(-60.0, 60.1, 5.0)
UNITS = {
    "an eccentricity over a short range": Unit(ARC, wave(0.9), [ECCENTRICITY]),
    "an eccentricity over a quarter turn": Unit(np.arange(0.0, 90.1, 5.0), wave(1.2), [ECCENTRICITY]),
    "a quadratic and a cubic term": Unit(ARC, curve, [NONLINEARITY]),
    "an order of the turn": Unit(np.arange(0, 360, 7.5), wave(0.2, 3.0), [("stage_periodic", ORDER_3)]),
    "a bias that follows temperature": Unit(
        np.tile(ARC[::2], 3), lambda _, celsius: 0.02 * (celsius - 20.0), [WARMTH]
    ),
    "curves that cancel": Unit(np.arange(-70.0, 70.1, 5.0), two_that_cancel, [NONLINEARITY, ECCENTRICITY]),
}


def read(unit: Unit, rng: np.random.Generator, theta: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    exact = 0.5 + 1.002 * theta + unit.error_deg(theta, celsius)
    return exact + NOISE_DEG * rng.standard_normal(len(theta))


def issued(unit: Unit, rng: np.random.Generator) -> dict[str, Any]:
    """The document of a run of a unit, its effects fitted and accepted."""
    theta = unit.target_deg + rng.uniform(-1.0, 1.0, len(unit.target_deg))
    celsius = rng.uniform(20.0, 32.0, len(theta))
    both = zip(theta.tolist(), read(unit, rng, theta, celsius).tolist(), celsius.tolist(), strict=True)
    poses = [Pose(at_deg, read_deg, temperature_c=warm) for at_deg, read_deg, warm in both]
    fit = fit_together([RunOfEffects("1", poses)], unit.effects)
    accepted = []
    for (name, found), factor in zip(fit.effects, fit.factors, strict=True):
        known = {key: one for key, one in found.items() if one is not None}
        values = {key: one["value"] for key, one in known.items()}
        stds = {key: std for key, one in known.items() if (std := one["std"]) is not None}
        more = {"runs": ["1"], "std": stds, "factor": factor}
        accepted.append(AcceptedEffect("1", "A", None, name, "sensor", values, **more))
    doubt = doubt_of(accepted, "1")
    result = build_result(poses, effects=as_applied(accepted), reference=GOOD, doubt=doubt)
    return calibration_content(
        unit="A", rig=None, poses=poses, result=result, accepted=accepted, reference=GOOD
    )


@pytest.mark.parametrize("name", UNITS)
def test_errors_at_other_angles_are_as_large_as_stated(name: str) -> None:
    """Forty runs of each unit. With bias and scale alone, curves that cancel were overstated 50 times."""
    unit, in_stds = UNITS[name], []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        application = Application.of_document(issued(unit, rng))
        low, high = application.range_deg
        theta, celsius = np.linspace(low + 0.1, high - 0.1, 25), rng.uniform(20.0, 32.0, 25)
        found = application.elevation_deg(read(unit, rng, theta, celsius), celsius)
        stated = application.std_deg(np.clip(found, low, high), celsius)
        in_stds += [((found - theta + 180.0) % 360.0 - 180.0) / stated]
    assert 0.9 < math.sqrt(np.mean(np.square(in_stds))) < 1.15
    of_each_angle = np.sqrt(np.mean(np.square(in_stds), axis=0))
    assert of_each_angle.max() < 1.5, "nor is it smaller at the ends of the range"


@pytest.mark.parametrize("name", UNITS)
def test_u_and_the_certificates_budget_say_the_same_as_the_elevations(name: str) -> None:
    document = issued(UNITS[name], np.random.default_rng(7))
    application = Application.of_document(document)
    theta, celsius = np.linspace(*application.range_deg, 200), np.linspace(20.0, 32.0, 200)
    stated = application.std_deg(theta, np.random.default_rng(1).permutation(celsius))
    combined = document["expanded_uncertainty_deg"] / document["coverage_factor"]
    assert math.sqrt(np.mean(stated**2)) == pytest.approx(combined, rel=0.03)
    budget = budget_of(document, GOOD, document["degrees_of_freedom"])
    assert math.hypot(*(line.contribution_deg for line in budget.contributions)) == pytest.approx(combined)
    assert all(line.contribution_deg < 1.001 * combined for line in budget.contributions)


def test_the_variance_of_an_elevation_is_that_of_one_fit_of_all_parameters() -> None:
    """By hand: s²·(1 + g·(XᵀX)⁻¹·gᵀ), X of bias, scale, sine and cosine; over 60°, where these are alike."""
    unit = UNITS["an eccentricity over a short range"]
    application = Application.of_document(issued(unit, np.random.default_rng(2)))
    assert application.joint is not None

    def columns(theta: np.ndarray) -> np.ndarray:
        angle = np.radians(theta)
        return np.column_stack([np.ones(len(theta)), theta, np.sin(angle), np.cos(angle)])

    theta = np.linspace(*application.range_deg, len(unit.target_deg))
    inverse = np.linalg.inv(columns(theta).T @ columns(theta))
    by_hand = np.sqrt(1.0 + np.einsum("ni,ij,nj->n", columns(theta), inverse, columns(theta)))
    np.testing.assert_allclose(application.std_deg(theta) / application.joint.scatter_deg, by_hand, rtol=0.05)


def test_a_document_of_before_is_applied_as_before() -> None:
    document = issued(UNITS["an eccentricity over a short range"], np.random.default_rng(2))
    before = Application.of_document({**document, "joint_covariance": None})
    low, high = document["range_deg"]
    (of_bias, shared), (_, of_scale) = document["covariance"]
    theta = np.linspace(low, high, 20001)
    of_line = (of_bias + 2.0 * theta * shared + theta**2 * of_scale) / document["scale"] ** 2
    expected = document["uncertainty"]["type_a_deg"] ** 2 + of_line - of_line.mean()
    np.testing.assert_allclose(before.std_deg(theta)[[0, -1]] ** 2, expected[[0, -1]], rtol=1e-3)
