"""Hysteresis that is not one play: widest in the middle of the range, or of a coupling that yields."""

from itertools import pairwise

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import Pose
from calrig.calibration.regression.request import DiagnosisRequest

NOISE_DEG = 0.02


def strokes(*turns_deg: float, step_deg: float = 2.5) -> np.ndarray:
    ends = [0.0, *turns_deg]
    parts = [np.arange(a, b, np.copysign(step_deg, b - a)) for a, b in pairwise(ends)]
    return np.append(np.concatenate(parts), ends[-1])


def measured(theta_deg: np.ndarray, error_deg: np.ndarray, seed: int = 1) -> list[Pose]:
    noise_deg = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(theta_deg))
    sense = np.append(1, np.sign(np.diff(theta_deg))).astype(int)
    return posed(
        target_deg=theta_deg,
        reading_deg=theta_deg + error_deg + noise_deg,
        approach=sense,
        time_s=5.0 * np.arange(len(theta_deg)),
    )


def found_in(poses: list[Pose]) -> dict:
    return document(diagnose([poses], request=DiagnosisRequest(reference="good"), bootstraps=199), ["1"])


def jenkins(theta_deg: np.ndarray, yield_deg: float) -> np.ndarray:
    """Many springs that slip beyond a limit each, limits spread as an exponential law has them (Iwan, Journal
    of Applied Mechanics 33, 1966)."""
    share = (np.arange(400) + 0.5) / 400
    limits_deg = -yield_deg * np.log1p(-share)
    stretched_deg, mean = np.zeros(400), []
    for move_deg in np.diff(theta_deg, prepend=theta_deg[0]):
        stretched_deg = np.clip(stretched_deg + move_deg, -limits_deg, limits_deg)
        mean.append(np.mean(stretched_deg / limits_deg))
    return np.array(mean)


@pytest.mark.parametrize("cycles", [1, 2])
def test_a_hysteresis_widest_in_the_middle_is_no_cycle_in_time(cycles: int) -> None:
    theta_deg = strokes(*[90.0, 0.0] * cycles)
    sense = np.append(1, np.sign(np.diff(theta_deg)))
    found = found_in(measured(theta_deg, 0.5 * sense * np.sin(2.0 * np.radians(theta_deg))))
    assert {effect["covariate"] for effect in found["effects"]} == {"approach", "approach·target_deg"}
    assert found["final"]["held_out_rms_deg"] < 1.2 * NOISE_DEG


@pytest.mark.parametrize("turns_deg", [(90.0, 0.0, 90.0, 0.0), (90.0, 0.0, 60.0, 0.0, 30.0, 0.0, 90.0, 0.0)])
def test_a_coupling_that_yields_is_a_hysteresis_of_its_size_after_every_turn(turns_deg: tuple) -> None:
    theta_deg = strokes(*turns_deg)
    found = found_in(measured(theta_deg, 0.4 * jenkins(theta_deg, yield_deg=3.0)))
    (effect,) = found["effects"]
    size, way = (effect["parameters"][name]["value"] for name in ("backlash_deg", "yield_deg"))
    assert (effect["name"], effect["verdict"]) == ("backlash", "named")
    assert size == pytest.approx(0.8, rel=0.05)
    assert 1.5 < way < 6.0
    assert found["final"]["fit_rms_deg"] < 1.1 * NOISE_DEG
    assert found["final"]["held_out_rms_deg"] < 2.0 * NOISE_DEG  # what of the first pose nothing tells


def test_readings_that_overshoot_after_a_move_are_no_hysteresis() -> None:
    theta_deg = np.random.default_rng(3).uniform(-60.0, 60.0, 70)
    found = found_in(measured(theta_deg, 0.012 * np.diff(theta_deg, prepend=0.0)))
    (effect,) = found["effects"]
    assert (effect["name"], effect["covariate"]) == ("unnamed", "move_deg")
    assert found["final"]["held_out_rms_deg"] < 1.3 * NOISE_DEG
