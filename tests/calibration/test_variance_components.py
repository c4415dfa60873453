"""Variance components: against dense REML, against a balanced analysis of variance, against NIST's data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from calrig.calibration.histories.between_runs import components
from calrig.calibration.histories.repeatability import Layout, variance_components

SIRSTV = (
    (196.3052, 196.1240, 196.1890, 196.2569, 196.3403),
    (196.3042, 196.3825, 196.1669, 196.3257, 196.0422),
    (196.1303, 196.2005, 196.2889, 196.0343, 196.1811),
    (196.2795, 196.1748, 196.1494, 196.1485, 195.9885),
    (196.2119, 196.1051, 196.1850, 196.0052, 196.2090),
)
"""NIST/SEMATECH Statistical Reference Datasets, one-way ANOVA, `SiRstv` (five instruments); certified mean
squares 1.27865654000000E-02 between and 1.08318280000000E-02 within."""
MEAN_SQUARES = (1.27865654e-02, 1.08318280e-02)


def crossed(seed, units=8, rigs=2, runs=60, days=12, known=(0.01, 0.03)):
    """Runs of units on rigs on days, with what spreads them: 0.5, 0.2, 0.05 and 0.04."""
    rng = np.random.default_rng(seed)
    unit, rig = rng.integers(0, units, runs), rng.integers(0, rigs, runs)
    _, day = np.unique(rig * days + rng.integers(0, days, runs), return_inverse=True)
    std = rng.choice(known, runs)
    value = (
        rng.normal(0, 0.5, units)[unit]
        + rng.normal(0, 0.2, rigs)[rig]
        + rng.normal(0, 0.05, day.max() + 1)[day]
        + rng.normal(0, 0.04, runs)
        + std * rng.normal(size=runs)
    )
    return value, Layout(unit, rig, day, std**2)


def dense_criterion(value, layout, unit, rig, day, run):
    """−2 log restricted likelihood by the definition, with the whole covariance matrix."""
    same = [(kind[:, None] == kind) * 1.0 for kind in (layout.unit, layout.rig, layout.day)]
    v = unit * same[0] + rig * same[1] + day * same[2] + np.diag(run + layout.known_variance)
    x = np.ones((len(value), 1))
    inverse = np.linalg.inv(v)
    information = x.T @ inverse @ x
    residual = value - x @ np.linalg.solve(information, x.T @ inverse @ value)
    return np.linalg.slogdet(v)[1] + np.linalg.slogdet(information)[1] + residual @ inverse @ residual


@pytest.mark.parametrize("seed", range(3))
def test_the_components_are_those_of_dense_restricted_likelihood(seed):
    value, layout = crossed(seed)
    found = variance_components(value, layout)
    ours = np.array([found.unit, found.rig, found.day, found.run])

    def dense(roots):
        return dense_criterion(value, layout, *np.asarray(roots) ** 2)

    best = minimize(
        dense, [0.5, 0.2, 0.05, 0.04], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}
    )
    assert dense(np.sqrt(ours)) == pytest.approx(best.fun, abs=1e-4)
    assert found.criterion == pytest.approx(dense(np.sqrt(ours)), abs=1e-4)
    np.testing.assert_allclose(np.sqrt(ours), np.abs(best.x), rtol=0.01, atol=1e-3)


def test_one_way_and_balanced_they_are_those_of_nists_analysis_of_variance():
    unit = np.repeat(np.arange(5), 5)
    nothing = np.zeros(25, dtype=np.intp)
    found = variance_components(np.ravel(SIRSTV), Layout(unit, nothing, nothing, np.zeros(25)))
    between, within = MEAN_SQUARES
    assert found.run == pytest.approx(within, rel=1e-4)
    assert found.unit == pytest.approx((between - within) / 5, rel=1e-2)
    assert found.day is None
    moments = components(unit.tolist(), np.ravel(SIRSTV).tolist())
    assert moments.within == pytest.approx(within**0.5, rel=1e-9)
    assert moments.between == pytest.approx(((between - within) / 5) ** 0.5, rel=1e-6)


def test_what_runs_were_drawn_with_comes_back():
    value, layout = crossed(7, units=60, rigs=6, runs=1500, days=60)
    found = variance_components(value, layout)
    assert found.day is not None
    assert [found.unit**0.5, found.day**0.5, found.run**0.5] == pytest.approx([0.5, 0.05, 0.04], rel=0.25)


def test_a_day_for_every_run_leaves_its_spread_with_the_runs():
    value, layout = crossed(3, runs=40)
    own_days = Layout(layout.unit, np.zeros(40, dtype=np.intp), np.arange(40), layout.known_variance)
    assert variance_components(value, own_days).day is None


def test_figures_that_repeat_exactly_have_no_spread():
    nothing = np.zeros(6, dtype=np.intp)
    layout = Layout(np.repeat([0, 1, 2], 2), nothing, nothing, np.full(6, 1e-4))
    assert variance_components(np.full(6, 0.3), layout).run == 0.0
    assert variance_components(np.repeat([0.1, 0.5, 0.9], 2), layout).run == pytest.approx(0.0, abs=1e-6)
