"""A mount that does not fit the others is told of, and noise alone tells of none."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calrig.calibration.separation.lack_of_fit import misfits
from calrig.calibration.separation.map_report import common_variance
from calrig.calibration.separation.report import solution_document
from calrig.calibration.separation.solution import solve

from .cases import ROUGH
from .rig import Bench, Unit, poses_of

STEADY = replace(ROUGH, warm_c=0.0)


def measured(seed, wrong=lambda bench, _visit: bench, correlation=0.0):
    """The poses of three mounts, something wrong with the bench in the second of them."""
    bench = replace(STEADY, correlation=correlation).bench(seed)
    rng = np.random.default_rng([seed, 150])
    benches = [wrong(bench, visit) if k == 1 else bench for k, visit in enumerate(bench.visits)]
    return [
        lot
        for one, visit in zip(benches, bench.visits, strict=True)
        for lot in replace(one, visits=(visit,)).measured(rng)
    ]


def with_another_map(bench: Bench, _visit):
    moved = (*bench.stage.waves, (2, 0.15, 100.0), (3, 0.1, 30.0))
    return replace(bench, stage=replace(bench.stage, waves=moved))


def with_another_unit(bench: Bench, _visit):
    return replace(bench, units=(Unit((20.0, -40.0), (1.0, -1.0)),))


def creeping(bench: Bench, lots, deg_per_decade=0.1):
    """The second mount again, its clamp giving by so much for each decade of time."""
    visit = bench.visits[1]
    since = 1.0 + 10.0 * np.arange(len(visit.dial_deg))
    each = [
        replace(
            visit,
            dial_deg=visit.dial_deg[k : k + 1],
            approach=visit.approach[k : k + 1],
            die_c=visit.die_c[k : k + 1],
            clamp_deg=visit.clamp_deg + deg_per_decade * math.log10(since[k]),
        )
        for k in range(len(since))
    ]
    noise = np.random.default_rng(4).normal(0.0, math.radians(bench.noise_deg), (len(each), 2))
    vectors = np.concatenate([bench.felt_g(one) for one in each]) + noise
    return [lots[0], replace(lots[1], poses=poses_of(visit, vectors)), lots[2]]


@pytest.mark.parametrize(
    ("lots", "cause"),
    [
        (measured(0, with_another_map), "the stage had another map there"),
        (measured(0, with_another_unit), "it were of another unit"),
        (creeping(STEADY.bench(0), measured(0)), "its angle moved while it was measured"),
    ],
)
def test_a_mount_that_does_not_fit_the_others_is_named_with_what_it_looks_like(lots, cause):
    document = solution_document(solve(lots))
    (said,) = [sentence for sentence in document["warnings"] if "does not fit the others" in sentence]
    assert "mount m1 of unit U0" in said
    assert cause in said
    assert document["mounts"][1]["fits_p_value"] < 0.01


def test_what_is_correlated_beyond_noise_is_told_of():
    found = solution_document(solve(measured(0, with_another_unit)))
    assert any("more as a lack of fit than as noise" in sentence for sentence in found["warnings"])


def test_mounts_that_fit_are_not_told_of():
    document = solution_document(solve(measured(1)))
    assert all(mount["fits_p_value"] > 0.01 for mount in document["mounts"])
    assert not any("does not fit" in said or "repeats every" in said for said in document["warnings"])


def test_a_gear_that_nobody_stated_is_told_of_with_its_period():
    bench = STEADY.bench(2)
    geared = replace(bench.stage, waves=(*bench.stage.waves, (50, 0.06, 10.0)))
    lots = replace(bench, stage=geared).measured(np.random.default_rng(2))
    (said,) = [sentence for sentence in solution_document(solve(lots))["warnings"] if "--period" in sentence]
    assert "repeats every 7.2° of the dial" in said
    stated = solution_document(solve(lots, periods_deg=[7.2]))
    assert not any("repeats every" in sentence for sentence in stated["warnings"])


@pytest.mark.statistical
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_alone_has_no_mount_told_of(correlation):
    told = sum(
        bool(misfits(solve(measured(seed, correlation=correlation)).mount_tests)) for seed in range(40)
    )
    assert told <= 3, "one in a hundred by its level; 4 of 40 in one case in a thousand"


@pytest.mark.parametrize("common_std", [0.0, 0.05])
def test_the_misfit_in_common_at_an_angle_is_found_without_the_noise_of_its_poses(common_std):
    """Of 25 angles in three mounts, each four times: the mean of many draws is the variance put in."""
    rng = np.random.default_rng(0)
    dial, mount = (
        part.ravel() for part in np.meshgrid(np.linspace(-60.0, 60.0, 25), np.repeat([0, 1, 2], 4))
    )
    table = SimpleNamespace(dial_deg=dial, mount=mount, approach=np.ones(len(dial)))
    common = np.sin(np.arange(25))
    common *= common_std / np.sqrt(np.mean(common**2))
    found = []
    for _ in range(200):
        left = np.tile(common, 12) + rng.normal(0.0, 0.1, len(dial))
        fit = SimpleNamespace(
            problem=SimpleNamespace(table=table), kept=dial < 90.0, left=lambda left=left: left
        )
        found.append(common_variance(fit))
    assert np.mean(found) == pytest.approx(common_std**2, rel=0.05, abs=2e-5)
