"""What changed between runs: beside pooled repeatability, with a stated rate of false discoveries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import false_discovery_control, t

from calrig.calibration.histories.between_runs import changes, differences, rejection_level
from calrig.calibration.histories.repeatability import Repeatability, Runs, outlying, repeatability

BENJAMINI_HOCHBERG = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240,
                      0.4262, 0.5719, 0.6528, 0.7590, 1.0000]  # fmt: skip
"""The example of their paper, section 4.1: four of fifteen hypotheses are rejected at 0.05."""

RECLAMPED, A_DAY = 0.03, 0.02


def runs_of(units, runs, seed, moved=None, size=1.0, rigs=1, days="own", type_a=(0.005, 0.015)):
    """Units that repeat with 0.03, some of which move by `size` before a run (`moved`: unit → run)."""
    rng = np.random.default_rng(seed)
    unit = np.repeat(np.arange(units), runs)
    n = len(unit)
    of_day = np.tile(np.arange(runs), units) if days == "shared" else np.arange(n)
    rig = rng.integers(0, rigs, n)
    day = np.unique(rig * n + of_day, return_inverse=True)[1]
    std = rng.choice(type_a, n)
    shift = A_DAY * rng.normal(size=day.max() + 1)[day] if days == "shared" else 0.0
    value = (
        rng.normal(0, 0.5, units)[unit] + shift + RECLAMPED * rng.normal(size=n) + std * rng.normal(size=n)
    )
    for one, run in (moved or {}).items():
        value[one * runs + run : (one + 1) * runs] += size
    return Runs(unit, rig, day, value, std, np.zeros(n))


def marked(found):
    """The units that are said to have changed."""
    return {int(one) for one in found.unit[found.first[found.changed]]}


@pytest.mark.parametrize(
    ("days", "rigs", "stage_std"),
    [((0, 0), (0, 0), 0.0), ((0, 1), (0, 0), 0.0), ((0, 1), (0, 1), 0.0), ((0, 1), (0, 1), 0.3)],
)
def test_a_difference_scatters_as_stated_over_pairs_of_runs_drawn(days, rigs, stage_std):
    """Each unit twice: run, day and rig are drawn, what both runs share once; the stage's part as stated."""
    rng, n = np.random.default_rng(0), 40_000
    pooled = Repeatability(RECLAMPED, A_DAY, 0.0 if stage_std else 0.05, 0.0, 50)
    of_day, of_rig = (
        A_DAY * rng.normal(size=(n, 2)),
        np.hypot(pooled.rig, stage_std) * rng.normal(size=(n, 2)),
    )
    noise = np.array([0.01, 0.02]) * rng.normal(size=(n, 2)) + RECLAMPED * rng.normal(size=(n, 2))
    value = (of_day[:, list(days)] + of_rig[:, list(rigs)] + noise).ravel()
    unit, rig, day = np.repeat(np.arange(n), 2), np.tile(rigs, n), np.tile(days, n)
    runs = Runs(unit, rig, day, value, np.tile([0.01, 0.02], n), np.full(2 * n, stage_std**2))
    assert differences(runs, pooled).sigma.std() == pytest.approx(1.0, rel=0.02)


def test_the_level_of_the_paper_rejects_the_papers_four():
    level = rejection_level(np.array(BENJAMINI_HOCHBERG))
    assert sum(p <= level for p in BENJAMINI_HOCHBERG) == 4


@pytest.mark.parametrize("seed", range(5))
def test_what_is_rejected_is_what_scipy_rejects(seed):
    p_value = np.random.default_rng(seed).uniform(size=60) ** 3
    level = rejection_level(p_value)
    assert (p_value <= level).tolist() == (false_discovery_control(p_value) <= 0.05).tolist()


def test_nothing_is_rejected_of_nothing():
    assert rejection_level(np.empty(0)) == 0.0
    assert rejection_level(np.array([0.9, 0.2])) == 0.0


def test_one_unit_that_moved_stands_out_and_spoils_nothing():
    """Five units twice each, one of which moved by twenty times what re-clamping does."""
    moved = runs_of(5, 2, 3, {2: 1}, size=0.6)
    still = runs_of(5, 2, 3)
    found = changes((moved,))
    assert marked(found) == {2}
    assert found.pooled[0].run == pytest.approx(changes((still,)).pooled[0].run, rel=0.5)
    assert found.pooled[0].run < 3 * RECLAMPED


def test_a_reclamping_is_not_twenty_standard_errors():
    """Type A of 0.001° where re-clamping does 0.03°: every difference is 20 times its standard error."""
    found = changes((runs_of(12, 4, 0, type_a=(0.001,)),))
    (bias,) = found.figures
    assert np.median(np.abs(bias.value) / bias.type_a_std) > 10
    assert np.abs(bias.sigma).max() < 4
    assert not found.changed.any()


def test_two_runs_of_one_unit_tell_nothing_of_repeatability():
    found = changes((runs_of(1, 2, 0, {0: 1}),))
    assert found.pooled == (None,)
    assert np.isnan(found.p_value).all()
    assert not found.changed.any()


def test_of_two_repeats_that_disagree_neither_is_called_the_change():
    found = changes((runs_of(2, 2, 0, {0: 1}),))
    assert found.pooled == (None,)
    assert np.isnan(found.p_value).all()


def test_a_history_of_one_unit_is_its_own_repeatability():
    assert marked(changes((runs_of(1, 8, 1, {0: 4}),))) == {0}
    assert not changes((runs_of(1, 8, 1),)).changed.any()


def test_another_rig_adds_what_its_stage_is_worth():
    runs = runs_of(10, 3, 0, rigs=2)
    with_stage = Runs(runs.unit, runs.rig, runs.day, runs.value, runs.std, np.full(30, 0.2**2))
    (found,) = changes((with_stage,)).figures
    other = runs.rig[found.first] != runs.rig[found.second]
    assert (found.std[other] >= 0.2 * 2**0.5).all()
    assert (found.std[~other] < 0.15).all()


def test_runs_of_one_day_share_what_the_day_adds():
    runs = runs_of(30, 12, 4, days="shared")
    pooled = repeatability(runs, np.empty(0, dtype=np.intp))
    assert pooled.day == pytest.approx(A_DAY, rel=0.5)
    assert pooled.run == pytest.approx(RECLAMPED, rel=0.15)


def test_a_figure_that_is_not_known_of_some_runs_counts_where_it_is():
    runs = runs_of(6, 3, 0)
    value = runs.value.copy()
    value[::3] = np.nan
    found = changes((runs, Runs(runs.unit, runs.rig, runs.day, value, runs.std, runs.stage_variance)))
    assert np.isfinite(found.p_value).all()
    assert np.isnan(found.figures[1].sigma[::2]).all()


def test_no_run_at_all_changes_nothing():
    nothing = np.empty(0, dtype=np.intp)
    none = np.empty(0)
    found = changes((Runs(nothing, nothing, nothing, none, none, none),))
    assert (found.pooled, len(found.p_value)) == ((None,), 0)


@pytest.mark.filterwarnings("error")
def test_runs_that_agree_to_the_last_digit_stand_out_of_nothing():
    assert not outlying(np.zeros(5), np.zeros(5)).any()


def test_those_that_stand_out_are_found_however_many_hide_one_another():
    """A third of the differences is huge: held against the spread of all, none of them would stand out."""
    rng = np.random.default_rng(0)
    difference = rng.normal(0, 0.05, 30)
    difference[:10] += rng.choice([-1, 1], 10) * 1.5
    out = outlying(difference, np.full(30, 1e-4))
    assert np.flatnonzero(out).tolist() == list(range(10))


@pytest.mark.statistical
@pytest.mark.parametrize(("units", "runs"), [(1, 8), (5, 2), (5, 5), (20, 3), (40, 4)])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_of_the_units_marked_at_most_one_in_twenty_is_chance(units, runs, share):
    false, found = [], []
    for seed in range(100):
        rng = np.random.default_rng(1000 + seed)
        moved = {one: int(rng.integers(1, runs)) for one in range(units) if rng.random() < share}
        named = marked(changes((runs_of(units, runs, seed, moved, size=0.6),)))
        false.append(len(named - moved.keys()) / max(len(named), 1))
        found += [one in named for one in moved]
    assert np.mean(false) < 0.05 + 2 * 0.022
    assert not found or np.mean(found) > 0.5


@pytest.mark.parametrize(("share", "is_out"), [(0.97, False), (1.03, True)])
def test_one_difference_is_out_beyond_rosners_two_sided_bound(share, is_out):
    """Of ten differences with mean 0, nine of them ±1: Student's t of nine degrees of freedom, 5 %/(2·10)."""
    others = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    bound = t.ppf(1.0 - 0.05 / 20.0, 9)
    found = outlying(np.append(others, share * bound), np.full(10, 1e-9))
    assert found.tolist() == [False] * 9 + [is_out]
