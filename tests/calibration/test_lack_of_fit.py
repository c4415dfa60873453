"""Lack of fit: what is several times the pure error is said to be no noise; what is noise, hardly ever."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed
from scipy.stats import f

from calrig.calibration.diagnosis.lack_of_fit import LEVEL, LackOfFit, lack_of_fit, warning_of

SWEEP_DEG = np.linspace(-60.0, 60.0, 25)
TARGETS_DEG = np.concatenate([SWEEP_DEG, SWEEP_DEG[::-1], SWEEP_DEG, SWEEP_DEG[::-1]])
APPROACH = np.repeat([1, -1, 1, -1], len(SWEEP_DEG))
NOISE_DEG = 0.02


def held(
    residual_deg: np.ndarray,
    *,
    targets_deg: np.ndarray = TARGETS_DEG,
    dwell_deg: float | np.ndarray | None = None,
):
    """A residual after bias and scale, held against the pure error."""
    line = np.polyfit(targets_deg, residual_deg, 1)
    left_deg = residual_deg - np.polyval(line, targets_deg)
    read_deg = targets_deg + left_deg
    run = posed(target_deg=targets_deg, reading_deg=read_deg, approach=APPROACH, reading_stderr_deg=dwell_deg)
    lag1 = float(left_deg[1:] @ left_deg[:-1] / (left_deg @ left_deg))
    return lack_of_fit(
        [run],
        left_deg,
        np.zeros(len(run), dtype=bool),
        parameters=2,
        lag1_correlation=lag1,
        rounding_deg=1e-12,
    )


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(TARGETS_DEG))


def drift() -> np.ndarray:
    """Of 0.2° over the run, as a warm-up does it."""
    return 0.2 * (1.0 - np.exp(-np.linspace(0.0, 3.0, len(TARGETS_DEG))))


@pytest.mark.statistical
@pytest.mark.parametrize("dwell_deg", [None, NOISE_DEG])
def test_noise_lacks_nothing_at_the_nominal_rate(dwell_deg: float | None) -> None:
    runs = 600
    rejected = sum(held(noise(seed), dwell_deg=dwell_deg).rejects for seed in range(runs))
    assert rejected <= LEVEL * runs + 3.0 * (LEVEL * runs) ** 0.5


def test_noise_of_poses_that_are_never_revisited_is_held_against_the_dwells() -> None:
    jittered = TARGETS_DEG + np.random.default_rng(1).uniform(-2.0, 2.0, len(TARGETS_DEG))
    lack = held(noise(2), targets_deg=jittered, dwell_deg=NOISE_DEG)
    assert (lack.repeat, lack.rejects) == (None, False)
    assert lack.pure is not None
    assert lack.pure.std_deg == pytest.approx(NOISE_DEG)


def test_neighbours_of_a_stroke_in_small_steps_are_no_revisits() -> None:
    """A telescope's log: the elevation only rises, by less than what tells two targets apart."""
    residual_deg = noise(9) + 0.1 * np.sin(np.linspace(0.0, 20.0, len(TARGETS_DEG)))
    assert held(residual_deg, targets_deg=np.linspace(0.0, 0.4, len(TARGETS_DEG))).repeat is None
    twice_deg = np.repeat(np.linspace(0.0, 0.4, len(TARGETS_DEG) // 2), 2)
    assert held(residual_deg, targets_deg=twice_deg).repeat is not None
    to_and_fro_deg = 0.01 * np.arange(len(TARGETS_DEG)) + 0.031 * (np.arange(len(TARGETS_DEG)) % 2)
    assert held(residual_deg, targets_deg=to_and_fro_deg).repeat is None


@pytest.mark.parametrize("strokes", [2, 4])
def test_poses_passed_from_opposite_sides_on_the_move_are_no_revisits(strokes: int) -> None:
    """At uneven places, which a smooth curve through them overshoots: the sense is that of the stroke."""
    places_deg = np.sort(np.random.default_rng(11).uniform(0.0, 100.0, 60))
    sense = np.repeat(np.resize([1.0, -1.0], strokes), len(places_deg))
    targets_deg = np.concatenate([places_deg[:: int(one)] for one in sense[:: len(places_deg)]])
    residual_deg = 0.1 * sense + np.random.default_rng(12).normal(0.0, NOISE_DEG, len(sense))
    run = posed(target_deg=targets_deg, reading_deg=residual_deg, time_s=0.5 * np.arange(len(sense)))
    free = np.zeros(len(run), dtype=bool)
    lack = lack_of_fit([run], residual_deg, free, parameters=2, lag1_correlation=0.9, rounding_deg=0.0)
    if strokes == 2:
        assert lack.pure is None
    else:
        assert lack.pure is not None
        assert lack.pure.std_deg == pytest.approx(NOISE_DEG, rel=0.3)


def experiment(lack: LackOfFit, *, temperature: bool = True) -> str:
    said = warning_of(lack, found=False, temperature=temperature)
    assert said is not None
    return said.rsplit("; ", 1)[1]


@pytest.mark.parametrize("dwell_deg", [None, NOISE_DEG])
def test_a_drift_that_moves_revisits_apart_is_not_taken_for_what_the_rig_repeats_to(
    dwell_deg: float | None,
) -> None:
    lack = held(noise(3) + drift(), dwell_deg=dwell_deg)
    assert lack.pure is not None
    assert lack.pure.std_deg == pytest.approx(NOISE_DEG, rel=0.3)
    assert lack.rejects
    assert "warm the unit up once more" in experiment(lack)
    assert "record the temperature" in experiment(lack, temperature=False)


def test_a_shape_of_the_elevation_is_told_by_what_repeats() -> None:
    lack = held(noise(4) + 0.1 * np.sin(np.radians(9.0 * TARGETS_DEG)))
    assert lack.rejects
    assert "turn the unit on the stage" in experiment(lack)


def test_a_rig_that_does_not_repeat_is_worse_than_its_dwells_say_and_lacks_no_effect() -> None:
    lack = held(noise(5), dwell_deg=NOISE_DEG / 5.0)
    assert lack.pure is not None
    assert lack.pure.std_deg == pytest.approx(NOISE_DEG, rel=0.3)
    assert not lack.rejects


def test_where_neither_dwells_nor_revisits_tell_the_pure_error_nothing_is_claimed() -> None:
    jittered = TARGETS_DEG + np.random.default_rng(6).uniform(-2.0, 2.0, len(TARGETS_DEG))
    lack = held(noise(7), targets_deg=jittered)
    assert (lack.pure, lack.p_value, lack.rejects) == (None, None, False)
    assert warning_of(lack, found=False, temperature=False) is None


def test_a_slow_rest_is_said_though_nothing_tells_the_pure_error() -> None:
    jittered = TARGETS_DEG + np.random.default_rng(6).uniform(-2.0, 2.0, len(TARGETS_DEG))
    lack = held(noise(7) + drift(), targets_deg=jittered)
    told = warning_of(lack, found=False, temperature=False)
    assert lack.pure is None
    assert told is not None
    assert f"correlated by {lack.lag1_correlation:.2f}" in told


def test_the_residual_has_a_degree_of_freedom_less_for_each_parameter() -> None:
    residual_deg = noise(8)
    line = np.polyfit(TARGETS_DEG, residual_deg, 1)
    left_deg = residual_deg - np.polyval(line, TARGETS_DEG)
    residual = held(residual_deg).residual
    assert residual.freedom == len(TARGETS_DEG) - 2
    assert residual.std_deg == pytest.approx(np.sqrt(np.sum(left_deg**2) / (len(TARGETS_DEG) - 2)))


@pytest.mark.statistical
def test_the_pure_error_of_revisits_is_known_by_the_freedom_that_is_said() -> None:
    """Of a variance with ν degrees of freedom 2/ν is the squared coefficient of variation."""
    pure = [lack.pure for lack in (held(noise(seed)) for seed in range(500)) if lack.pure is not None]
    variances = np.array([one.std_deg**2 for one in pure])
    expected = 2.0 * variances.mean() ** 2 / variances.var()
    assert np.mean([one.freedom for one in pure]) == pytest.approx(expected, rel=0.25)


def test_the_p_value_is_that_of_the_residuals_variance_over_the_pure_errors() -> None:
    lack = held(noise(9) + 0.2 * drift())
    assert lack.pure is not None
    ratio = (lack.residual.std_deg / lack.pure.std_deg) ** 2
    assert lack.f == pytest.approx(ratio)
    assert lack.freedom[1] == lack.pure.freedom
    assert lack.p_value == pytest.approx(f.sf(ratio, *lack.freedom))


def test_dwells_that_know_their_error_by_ten_degrees_of_freedom_each_know_it_by_all_of_them() -> None:
    dwell_deg = NOISE_DEG * np.sqrt(np.random.default_rng(10).chisquare(10, len(TARGETS_DEG)) / 10.0)
    dwell = held(noise(10), dwell_deg=dwell_deg).dwell
    assert dwell is not None
    assert dwell.std_deg == pytest.approx(NOISE_DEG, rel=0.05)
    assert dwell.freedom == pytest.approx(10 * len(TARGETS_DEG), rel=0.4)
