"""An axis with play that differs along its range, a wavy scale, and a load that was turned round half-way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calrig.calibration import search
from calrig.calibration.diagnosis import diagnose, document
from calrig.calibration.pose import Pose
from calrig.calibration.responses import responses_of
from calrig.calibration.revisits import leaves_more, with_free_curve

STROKES, NOISE_DEG, LOAD_DEG = 8, 0.05, 0.4


def to_and_fro(seed: int, load_deg: float = LOAD_DEG) -> list[Pose]:
    """Strokes over 160°, read at 28 places."""
    rng = np.random.default_rng(seed)
    way = np.linspace(-80.0, 80.0, 28)
    poses = []
    for stroke in range(STROKES):
        approach = 1 if stroke % 2 == 0 else -1
        load = 1.0 if stroke < STROKES // 2 else -1.0
        for target in way[::approach]:
            wavy = 0.5 * np.sin(target / 9.0) + 0.7 * np.cos(target / 21.0 + 1.0)
            play = -1.5 * (0.3 + (target / 80.0) ** 2) * approach
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


def followed(said: dict[str, Any]) -> set[str]:
    return {effect["covariate"] for effect in said["effects"]}


def test_a_load_is_found_beside_a_curve_and_a_play_that_differ_along_the_range() -> None:
    said = traced(to_and_fro(1))
    assert {"load_sense", "approach", "approach·target_deg"} <= followed(said)
    (load,) = (e for e in said["effects"] if e["covariate"] == "load_sense")
    size = load["parameters"]["size_deg"]
    assert size["value"] == pytest.approx(LOAD_DEG, abs=4.0 * size["std"])
    assert said["final"]["fit_rms_deg"] == pytest.approx(NOISE_DEG, rel=0.3)


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


def test_without_the_second_look_the_load_stays_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "leaves_more", lambda _r, _residual: False)
    said = traced(to_and_fro(1))
    assert "load_sense" not in followed(said)
    assert said["final"]["fit_rms_deg"] > 5.0 * NOISE_DEG
