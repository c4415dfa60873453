"""A map solved from one unit's three mounts, as the reference of other units on that stage."""

from __future__ import annotations

import json
import math

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
