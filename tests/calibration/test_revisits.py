"""An axis with play that differs along its range, a wavy scale, and a load that was turned round half-way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from calrig.calibration.diagnosis.candidates import Candidate, candidates_of, model_columns
from calrig.calibration.diagnosis.lack_of_fit import leaves_more, with_free_curve
from calrig.calibration.diagnosis.reselection import competing_candidates
from calrig.calibration.diagnosis.selection import is_of_the_curve, search
from calrig.calibration.diagnosis.significance_test import Verdict, gate
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.line import rms
from calrig.calibration.poses import Pose
from calrig.calibration.regression.noise_model import fit
from calrig.calibration.regression.request import DiagnosisRequest
from calrig.calibration.regression.responses import Responses, responses_of

STROKES, NOISE_DEG, LOAD_DEG = 8, 0.05, 0.4


def to_and_fro(seed: int, load_deg: float = LOAD_DEG, waves_deg: float = 0.0) -> list[Pose]:
    """Strokes over 160°, read at 28 places."""
    rng = np.random.default_rng(seed)
    way = np.linspace(-80.0, 80.0, 28)
    poses = []
    for stroke in range(STROKES):
        approach = 1 if stroke % 2 == 0 else -1
        load = 1.0 if stroke < STROKES // 2 else -1.0
        for target in way[::approach]:
            wavy = waves_deg * np.sin(target / 16.0) + 0.7 * np.cos(target / 30.0 + 1.0)
            play = -1.0 * (0.3 + (target / 80.0) ** 2) * approach
            reading = target + wavy + play + 0.5 * load_deg * load + rng.normal(0.0, NOISE_DEG)
            poses.append(
                Pose(
                    target_deg=float(target),
                    reading_deg=float(reading),
                    sweep=stroke,
                    approach=approach,
                    covariates={"load_sense": load},
                )
            )
    return poses


def traced(poses: list[Pose]) -> dict[str, Any]:
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])


def judged(r: Responses, candidates: Sequence[Candidate]) -> Verdict:
    def columns_with(more: Sequence[Candidate]) -> np.ndarray:
        return model_columns(r, more)

    return gate(r, columns_with, fit(r, r.base), candidates, np.random.default_rng(1), 199, 0.005)


def followed(said: dict[str, Any]) -> set[str]:
    return {effect["covariate"] for effect in said["effects"]}


def test_a_load_is_found_beside_a_curve_and_a_play_that_differ_along_the_range() -> None:
    said = traced(to_and_fro(1))
    assert {"load_sense", "approach", "approach·target_deg"} <= followed(said)
    (load,) = (e for e in said["effects"] if e["covariate"] == "load_sense")
    size = load["parameters"]["size_deg"]
    assert size["value"] == pytest.approx(LOAD_DEG, abs=4.0 * size["std"])
    assert said["final"]["fit_rms_deg"] == pytest.approx(NOISE_DEG, rel=0.3)


@pytest.mark.parametrize("beside_curve", [True, False])
def test_a_fold_searches_beside_a_free_curve_if_all_poses_were_searched_so(beside_curve: bool) -> None:
    r = responses_of([to_and_fro(1)])
    candidates, rng = candidates_of(r), np.random.default_rng(0)
    found = search(r, candidates, rng, bootstraps=199).found
    rivals = competing_candidates(r, candidates, found, beside_curve=beside_curve)
    of_fold = search(r, candidates, rng, bootstraps=270, decide_only=True, rivals=rivals)
    assert of_fold.beside_curve is beside_curve
    assert "load_sense" in {f.candidate.covariate for f in of_fold.found}
    assert rms(of_fold.fitted.residuals[:, 0]) == pytest.approx(NOISE_DEG, rel=0.3)


def test_only_what_leaves_several_times_the_noise_is_looked_at_again() -> None:
    r = responses_of([to_and_fro(3)])
    rng = np.random.default_rng(0)
    assert leaves_more(r, rng.normal(0.0, 5.0 * NOISE_DEG, len(r)))
    assert not leaves_more(r, rng.normal(0.0, NOISE_DEG, len(r)))


def test_a_curve_for_each_side_wants_many_poses_and_revisits() -> None:
    poses = to_and_fro(4)
    assert with_free_curve(responses_of([poses[:100]])) is None
    table = sorted(poses, key=lambda pose: pose.target_deg)
    bare = [Pose(target_deg=p.target_deg, reading_deg=p.reading_deg) for p in table]
    assert not leaves_more(responses_of([bare]), np.full(len(bare), 1.0))


@pytest.mark.parametrize("load_deg", [0.0, LOAD_DEG])
def test_beside_free_curves_what_no_curve_is_shows_by_itself(load_deg: float) -> None:
    r = responses_of([to_and_fro(5, load_deg, waves_deg=0.5)])
    free = with_free_curve(r)
    assert free is not None
    others = [c for c in candidates_of(r) if not is_of_the_curve(c)]
    verdict = judged(free, others)
    best = others[int(np.argmax(verdict.ratios))]
    assert verdict.passes == (load_deg > 0.0)
    assert best.covariate == "load_sense" or not verdict.passes
    hidden = judged(r, others)  # where half of it is taken for noise that wanders
    assert hidden.gain < 0.5 * verdict.gain or not verdict.passes


PLACES_DEG = 15.0 + 10.0 * np.arange(5)


def iso_230_2(seed: int, apart_deg: float | None, cycles: int = 5) -> list[Pose]:
    """A run by ISO 230-2 of an axis with an error of its own at each of five places.

    It is the same from both sides but for a play of `apart_deg`; another one from each where that is None.
    """
    rng = np.random.default_rng(seed)
    up_deg, down_deg = rng.normal(0.0, 0.02, (2, 5))
    down_deg = down_deg if apart_deg is None else up_deg + apart_deg
    ways = [(1, PLACES_DEG, up_deg), (-1, PLACES_DEG[::-1], down_deg[::-1])]
    return [
        Pose(target_deg=float(at), reading_deg=float(at + off + rng.normal(0.0, 5e-4)), approach=approach)
        for _ in range(cycles)
        for approach, places_deg, error_deg in ways
        for at, off in zip(places_deg, error_deg, strict=True)
    ]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("apart_deg", [None, 0.0, 0.02])
def test_errors_at_few_places_have_no_other_cause_than_a_play_between_the_sides(seed, apart_deg):
    found = document(diagnose([iso_230_2(seed, apart_deg)], bootstraps=199), ["1"])
    causes = {effect["name"] for effect in found["effects"] if effect["verdict"] == "named"}
    assert causes == ({"backlash"} if apart_deg else set())
    assert found["final"]["held_out_rms_deg"] < 7e-4
    if apart_deg:
        (play,) = (e["parameters"]["backlash_deg"] for e in found["effects"] if e["name"] == "backlash")
        assert abs(abs(play["value"]) - apart_deg) < 4.0 * play["std"]


def test_a_first_pose_come_to_from_nowhere_tells_no_play_at_few_places():
    one_way = [pose for pose in iso_230_2(1, 0.0, cycles=8) if pose.approach == 1]
    poses = [Pose(target_deg=pose.target_deg, reading_deg=pose.reading_deg) for pose in one_way]
    found = document(diagnose([poses], bootstraps=199), ["1"])
    assert [effect["name"] for effect in found["effects"]] == ["unnamed"]
    assert not any("outlier" in said for said in found["warnings"])


def test_a_smooth_curve_at_few_places_keeps_its_name():
    poses = iso_230_2(2, 0.0)
    bent = [
        Pose(
            target_deg=pose.target_deg,
            reading_deg=pose.target_deg + 1e-4 * (pose.target_deg - 35.0) ** 2 + error,
            approach=pose.approach,
        )
        for pose, error in zip(poses, np.random.default_rng(3).normal(0.0, 5e-4, len(poses)), strict=True)
    ]
    found = document(diagnose([bent], bootstraps=199), ["1"])
    assert [effect["name"] for effect in found["effects"]] == ["nonlinearity"]


def test_the_same_effect_at_other_places_is_not_that_of_a_rival():
    """Random errors at seven places, each five times from one side, where the sensor is compared."""
    rng = np.random.default_rng(2)
    at = np.linspace(15.0, 55.0, 7)
    off = rng.normal(0.0, 0.02, 7)
    poses = [
        Pose(target_deg=float(t), reading_deg=float(t + e + rng.normal(0.0, 5e-4)), sweep=sweep)
        for sweep in range(5)
        for t, e in zip(at, off, strict=True)
    ]
    found = document(diagnose([poses], request=DiagnosisRequest(reference="good"), bootstraps=199), ["1"])
    assert found["final"]["held_out_rms_deg"] < 7e-4
