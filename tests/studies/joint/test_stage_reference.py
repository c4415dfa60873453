"""A map solved from one unit's three mounts, as the reference of other units on that stage."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.separation.map_validity import checked
from calrig.calibration.separation.stage_map import MapError, StageMap, dial_of, map_reference, with_map
from calrig.calibration.uncertainty.budget import Reference
from calrig.canonical_json import sha256_of
from calrig.export.solution_documents import stage_map_document

from .cases import solved
from .rig import REFERENCE_C, Bench, Design, Stage, Unit, Visit, drawn_stage, drawn_unit

THREE = Design((0.0, 120.0, 240.0))
CERTIFICATE = Reference(0.29)


def mapped_stage(seed: int) -> tuple[Stage, StageMap]:
    """A stage worth 0.29°, and its map from a unit that was clamped at three angles."""
    rng = np.random.default_rng([seed, 77])
    stage, unit = drawn_stage(rng, gap_deg=0.05), drawn_unit(rng)
    bench = Bench((unit,), stage, THREE.visits(rng))
    return stage, StageMap.from_document(stage_map_document(solved(bench, seed, linear=False)))


def calibrated_once(seed: int, stage: Stage, unit: Unit | None = None) -> list[Pose]:
    """The poses of a usual plan by the stage's word; of a faultless unit where none is given."""
    rng = np.random.default_rng([seed, 78])
    up = np.arange(-60.0, 61.0, 10.0)
    dial, approach = np.concatenate([up, up[::-1]] * 2), np.repeat([1.0, -1.0, 1.0, -1.0], len(up))
    visit = Visit(0, rng.normal(0.0, 0.8), dial, approach, np.full(len(dial), REFERENCE_C))
    return list(Bench((unit or Unit(),), stage, (visit,)).measured(rng)[0].poses)


@pytest.fixture(scope="module")
def bench() -> tuple[Stage, StageMap]:
    return mapped_stage(1)


def by_map(poses: list[Pose], stage_map: StageMap):
    mapped = with_map(poses, stage_map)
    theta = np.array([pose.theta_deg for pose in mapped])
    return build_result(mapped, reference=map_reference(stage_map, theta, *dial_of(mapped)))


def test_the_expanded_uncertainty_is_the_maps_and_no_longer_the_certificates(bench):
    stage, stage_map = bench
    poses = calibrated_once(1, stage)
    before, after = build_result(poses, reference=CERTIFICATE), by_map(poses, stage_map)
    assert before.over_range.expanded_uncertainty_deg > 0.47
    assert after.over_range.expanded_uncertainty_deg < 0.07
    assert after.reference.std_deg < 0.01
    assert after.rms_raw_deg == before.rms_raw_deg, "reading minus stage, as it came"
    assert after.rms_calibrated_deg < 0.25 * before.rms_calibrated_deg
    assert after.over_range.coverage_factor == pytest.approx(2.0, abs=0.05), "normal"


def test_what_a_run_keeps_is_the_map(bench):
    _, stage_map = bench
    kept = StageMap.from_frozen(json.loads(json.dumps(stage_map.frozen())))
    dial = np.linspace(-60.0, 60.0, 9)
    assert kept.correction_deg(dial, dial * 0.0 + 1.0).tolist() == pytest.approx(
        stage_map.correction_deg(dial, dial * 0.0 + 1.0).tolist()
    )
    assert kept.std_deg == pytest.approx(stage_map.std_deg)
    assert kept.covers(np.array([-61.5, -60.5, 0.0, 300.0, 360.0, 100.0])).tolist() == [0, 1, 1, 1, 1, 0]


def test_effects_that_were_fitted_may_have_taken_up_all_of_the_map(bench):
    stage, stage_map = bench
    poses = with_map(calibrated_once(1, stage), stage_map)
    theta = np.array([pose.theta_deg for pose in poses])
    straight, bent = (map_reference(stage_map, theta, *dial_of(poses), bent=one) for one in (False, True))
    assert straight.std_deg < bent.std_deg < 1.5 * stage_map.std_deg
    levelled = map_reference(stage_map, theta, *dial_of(poses), level=CERTIFICATE)
    assert levelled.std_deg == straight.std_deg
    assert math.sqrt(levelled.line_covariance[0][0]) > CERTIFICATE.std_deg, "no map tells the level"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "calrig.calibration/2"}, "no stage's map"),
        ({"orders": [1.0]}, "changed since it was made"),
        ({"separable": False}, "do not part the stage"),
        ({"coefficients_deg": [0.0]}, "not the 13 coefficients"),
        ({"covariance_deg2": np.full((13, 13), math.inf)}, "not finite"),
        ({"covariance_deg2": -np.eye(13)}, "a covariance that is none"),
        ({"map": {}}, "not as calrig makes it"),
    ],
)
def test_what_is_no_map_is_refused(change, said):
    content = {
        "schema": "calrig.stage-map/1",
        "orders": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        "coefficients_deg": [0.0] * 13,
        "covariance_deg2": np.eye(13).tolist(),
        "map": {"stage_deg": [-60.0, 60.0]},
        "separable": True,
    }
    StageMap.from_document({**content, "sha256": sha256_of(content)})
    broken = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in change.items()}
    try:
        sha256 = sha256_of({**content, **broken}) if "orders" not in change else "other"
    except ValueError:  # no hash of what is not finite
        sha256 = ""
        said = "not as calrig makes it"
    with pytest.raises(MapError, match=said):
        StageMap.from_document({**content, **broken, "sha256": sha256})


def test_a_map_that_moved_is_told_of_and_where(bench):
    stage, stage_map = bench
    unit = drawn_unit(np.random.default_rng(3))
    before = calibrated_once(4, stage, unit)
    kept = checked(calibrated_once(5, stage, unit), before, stage_map)
    assert not kept.has_moved
    assert not kept.at_deg
    turned = Stage(tuple((k, a, phase + 20.0 * k) for k, a, phase in stage.waves), stage.gap_deg)
    moved = checked(calibrated_once(5, turned, unit), before, stage_map)
    assert moved.has_moved
    assert moved.largest_at_deg in moved.at_deg
    assert checked(before[:5], before, stage_map) is None, "five poses tell nothing"


def test_a_map_that_knows_an_order_badly_hides_no_change_of_it(bench):
    """The map's error cancels in a difference of two runs by it: its covariance has no place there."""
    stage, stage_map = bench
    unit = drawn_unit(np.random.default_rng(3))
    before = calibrated_once(4, stage, unit)
    now = calibrated_once(5, Stage((*stage.waves, (4, 0.15, 0.0)), stage.gap_deg), unit)
    assert checked(now, before, stage_map).has_moved
    sine = 2 * stage_map.orders.index(4.0) + 1
    variance = stage_map.covariance_deg2.copy()
    variance[sine, sine] += 0.15**2
    assert checked(now, before, replace(stage_map, covariance_deg2=variance)).has_moved


def test_the_guard_states_the_change_that_it_can_see(bench):
    """Of waves as large as stated, of a phase drawn at random, most are seen; of a third of it, few."""
    stage, stage_map = bench
    unit = drawn_unit(np.random.default_rng(3))
    before = calibrated_once(4, stage, unit)
    order, from_deg = 4, checked(before, calibrated_once(5, stage, unit), stage_map).seen_from_deg[1]

    def seen(share: float) -> int:
        return sum(
            checked(
                calibrated_once(100 + seed, changed(share, 36.0 * seed), unit), before, stage_map
            ).has_moved
            for seed in range(10)
        )

    def changed(share: float, phase: float) -> Stage:
        wave = (order, share * from_deg * math.sqrt(2.0), phase)
        return Stage((*stage.waves, wave), stage.gap_deg)

    assert seen(1.3) >= 8
    assert seen(0.3) <= 3


def test_the_uncertainty_by_a_map_is_that_of_lines_through_maps_drawn_from_its_covariance(bench):
    """The series is written out here; a line takes what it can of it, and errs by its slope."""
    _, stage_map = bench
    theta, approach = np.linspace(-60.0, 30.0, 25), np.resize([1.0, -1.0], 25)

    def columns(dial, sense):
        waves = [wave(np.radians(k * dial)) for k in stage_map.orders for wave in (np.cos, np.sin)]
        return np.column_stack([*waves, 0.5 * sense])

    middle = columns(stage_map.dial_deg, np.zeros(len(stage_map.dial_deg))).mean(axis=0)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(len(middle)), stage_map.covariance_deg2, 20_000)
    error_deg = (columns(theta, approach) - middle) @ drawn.T
    slopes, levels = np.polyfit(theta, error_deg, 1)
    over_range = np.linspace(-60.0, 30.0, 901)
    straight = map_reference(stage_map, theta, theta, approach)
    by_slope_deg = slopes.std() * np.sqrt(np.mean((over_range - over_range.mean()) ** 2))
    assert straight.std_deg == pytest.approx(by_slope_deg, rel=0.03)
    assert straight.line_covariance[1][1] == pytest.approx(slopes.var(), rel=0.05)
    assert straight.line_covariance[0][0] == pytest.approx(levels.var(), rel=0.05)
    bent = map_reference(stage_map, theta, theta, approach, bent=True)
    about = error_deg - error_deg.mean(axis=0)
    assert bent.std_deg == pytest.approx(np.sqrt(np.mean(about**2)), rel=0.03)


@pytest.mark.statistical
def test_what_is_stated_covers_over_many_stages():
    """Of the expanded uncertainty of a fresh reading, and of the scale, in which the map is half of it."""
    within, scales = [], []
    for seed in range(24):
        stage, stage_map = mapped_stage(seed)
        for again in range(4):
            result = by_map(calibrated_once(100 * again + seed, stage), stage_map)
            theta = np.linspace(-60.0, 60.0, 241)
            error = theta / result.scale - theta
            noise = np.random.default_rng([seed, again]).normal(0.0, 0.03, len(theta))
            within.append(np.abs(error + noise) <= result.over_range.expanded_uncertainty_deg)
            scales.append((result.scale - 1.0) / math.hypot(result.scale_std, result.reference.scale_std))
    assert 0.93 < np.mean(within) < 0.97
    assert 0.8 < np.sqrt(np.mean(np.square(scales))) < 1.25
