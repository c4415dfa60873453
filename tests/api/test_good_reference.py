"""With a good reference an encoder's orders are the unit's: found, accepted, issued, exported, applied."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from compiled_header import COMPILER, applied, compiled
from support import imported, running_service, serving

from calrig.loaded import Calibration
from calrig.settings import ReferenceSettings

ORDERS = {1: (0.6, 20.0), 2: (0.9, -50.0), 4: (0.4, 110.0)}
"""Amplitude, degrees, and phase, degrees, by order of the turn."""
NOISE_DEG = 0.05


def encoder():
    """One turn of an encoder beside its shaft, at 96 uneven angles: target and reading."""
    rng = np.random.default_rng(3)
    target_deg = (np.arange(96) * 3.75 + rng.uniform(-1.2, 1.2, 96)).round(3)
    error_deg = sum(a * np.sin(np.radians(k * target_deg + phase)) for k, (a, phase) in ORDERS.items())
    return target_deg, (target_deg + 3.0 + error_deg + rng.normal(0.0, NOISE_DEG, 96)).round(4)


@pytest.fixture(scope="module")
def bench(rig, tmp_path_factory):
    """A service whose rig has a good reference, and a client of it."""
    reference = ReferenceSettings(std_deg=0.002, kind="setting", good=True)
    good = rig.model_copy(update={"reference": reference, "periods_deg": (7.2,)})
    path = tmp_path_factory.mktemp("bench") / "calrig.db"
    with running_service(path, good) as service, serving(service) as client:
        yield client


@pytest.fixture(scope="module")
def traced(bench):
    """The address of an imported run of the encoder, and its diagnosis as the rig has it."""
    rows = (f"{target},{reading}" for target, reading in zip(*encoder(), strict=True))
    run = imported(bench, "EN-1", "\n".join(["target_deg,reading_deg", *rows]), rig="bench-1")
    url = f"/api/runs/{run['id']}"
    return url, bench.post(f"{url}/diagnosis", json={}).raise_for_status().json()


def test_the_rig_says_that_its_reference_is_good_and_which_periods_are_known(bench, traced):
    url, found = traced
    assert (found["reference"], found["known_periods_deg"]) == ("good", [7.2])
    assert bench.get(f"{url}/diagnosis").json()["reference"] == "good"
    assert {(e["origin"], e["covariate"], e["corrects"]) for e in found["effects"]} == {
        ("sensor", "target_deg", "unit")
    }
    orders = {
        round(360 / e["parameters"]["period_deg"]["value"])
        for e in found["effects"]
        if "period_deg" in e["parameters"]
    }
    assert {2, 4} <= orders
    assert found["follow_up"] is None
    assert not any("stage" in sentence for sentence in found["says"])
    assert any("reference" in sentence for sentence in found["says"])


def test_what_was_accepted_is_in_the_document_and_all_formats_agree(bench, traced, tmp_path):
    url, found = traced
    names = sorted({effect["name"] for effect in found["effects"]})
    bench.post(f"{url}/diagnosis/accept", json={"effects": names}).raise_for_status()
    path = "/api/units/EN-1/calibration?revision=latest"
    document = bench.get(path).raise_for_status().json()
    assert len(document["effects"]) == len(found["effects"]), "of one name all, not the last"
    assert all(effect["formula"] for effect in document["effects"])

    target_deg, reading_deg = encoder()
    calibration = Calibration(document)
    left_deg = calibration.elevation_deg(reading_deg) - target_deg
    left_deg = (left_deg + 180.0) % 360.0 - 180.0
    rms_deg = np.sqrt(np.mean(left_deg**2))
    assert rms_deg < 1.2 * NOISE_DEG
    assert rms_deg == pytest.approx(found["final"]["fit_rms_deg"], rel=0.01)
    assert rms_deg == pytest.approx(document["rms_with_effects_deg"], rel=0.01)

    text = bench.get(f"{path}&format=table").text
    table = np.genfromtxt(io.StringIO(text), delimiter=",", skip_header=2)
    by_table_deg = reading_deg + np.interp(reading_deg, table[:, 0], table[:, 1])
    by_apply_deg = calibration.elevation_deg(reading_deg)
    inside = np.abs(by_table_deg - by_apply_deg) < 180.0
    np.testing.assert_allclose(by_table_deg[inside], by_apply_deg[inside], atol=1e-3)
    assert inside.mean() > 0.95, "at the ends of the turn they may differ by a whole one"

    if COMPILER is not None:
        program = compiled(bench.get(f"{path}&format=c-header").text, tmp_path)
        in_c_deg = applied(program, reading_deg, np.full(len(reading_deg), 20.0))
        np.testing.assert_allclose((in_c_deg - by_apply_deg + 180.0) % 360.0 - 180.0, 0.0, atol=3e-4)


def test_what_is_accepted_again_is_known_as_well_as_before(bench, traced):
    url, found = traced
    names = sorted({effect["name"] for effect in found["effects"]})
    path = "/api/units/EN-1/calibration?revision=latest"
    first, again = (
        (bench.post(f"{url}/diagnosis/accept", json={"effects": those}), bench.get(path).json())[1]
        for those in (names, names[::-1])
    )
    assert again["expanded_uncertainty_deg"] == pytest.approx(first["expanded_uncertainty_deg"])
    assert again["joint_covariance"] is not None


def diagnosed(bench, unit, target_deg, reading_deg):
    """The address of an imported run of a unit, and its diagnosis."""
    rows = (f"{target},{reading:.6f}" for target, reading in zip(target_deg, reading_deg, strict=True))
    run = imported(bench, unit, "\n".join(["target_deg,reading_deg", *rows]), rig="bench-1")
    url = f"/api/runs/{run['id']}"
    return url, bench.post(f"{url}/diagnosis?wait=true", json={}).raise_for_status().json()


def test_a_doubt_about_the_name_alone_keeps_no_correction_out_of_force(bench):
    """A universal joint bent by 12°: tan reading = tan angle · cos 12°, an order 2 of the turn."""

    def joint_deg(angle_deg):
        there = np.radians(angle_deg)
        return np.degrees(np.arctan2(np.sin(there) * np.cos(np.radians(12.0)), np.cos(there))) % 360.0

    rng, target_deg = np.random.default_rng(1), 10.0 * np.arange(36)
    url, found = diagnosed(bench, "UJ-1", target_deg, joint_deg(target_deg) + rng.normal(0.0, 0.02, 36))
    (effect,) = found["effects"]
    assert {effect["name"], *effect["confusable_with"]} == {"axis_mismatch", "stage_periodic"}
    assert (effect["verdict"], effect["corrects"]) == ("ambiguous", "unit")
    assert found["follow_up"] is None
    assert not any("separate" in warning for warning in found["warnings"])
    bench.post(f"{url}/diagnosis/accept", json={"effects": [effect["name"]]}).raise_for_status()
    (revision, *_) = bench.get("/api/units/UJ-1/calibrations").json()
    assert "mismatch" in revision["reason"] and " or periodic error" in revision["reason"]

    calibration = Calibration(bench.get("/api/units/UJ-1/calibration?revision=latest").json())
    between_deg = np.arange(2.5, 350.0, 5.0)
    np.testing.assert_allclose(calibration.elevation_deg(joint_deg(between_deg)), between_deg, atol=0.02)


def test_curves_that_cancel_each_other_in_part_are_accepted_together_alone(bench):
    """An inclinometer that takes the arc sine of a gain 1 % too small: a cubic and an order 1 in one sum."""

    def inclinometer_deg(angle_deg):
        return np.degrees(np.arcsin(0.99 * np.sin(np.radians(angle_deg)) + 0.005))

    rng, target_deg = np.random.default_rng(1), np.arange(-70.0, 70.1, 5.0)
    url, found = diagnosed(
        bench, "IN-1", target_deg, inclinometer_deg(target_deg) + rng.normal(0.0, 0.02, 29)
    )
    names = [effect["name"] for effect in found["effects"]]
    assert (len(names), {effect["corrects"] for effect in found["effects"]}) == (2, {"unit"})
    for name, other in (names, names[::-1]):
        refused = bench.post(f"{url}/diagnosis/accept", json={"effects": [name]})
        assert (refused.status_code, f"together with {other}" in refused.json()["detail"]) == (409, True)
    bench.post(f"{url}/diagnosis/accept", json={"effects": names}).raise_for_status()

    calibration = Calibration(bench.get("/api/units/IN-1/calibration?revision=latest").json())
    between_deg = np.arange(-67.5, 70.0, 5.0)
    left_deg = calibration.elevation_deg(inclinometer_deg(between_deg)) - between_deg
    assert np.sqrt(np.mean(left_deg**2)) < 0.02, "as noisy as one reading; 0.18 without effects"


def test_another_question_is_another_diagnosis(bench, traced):
    url, _ = traced
    asked = {"reference": "stage", "periods": [24.0]}
    found = bench.post(f"{url}/diagnosis", json=asked).raise_for_status().json()
    assert (found["reference"], found["known_periods_deg"]) == ("stage", [7.2, 24.0])
    assert bench.get(f"{url}/diagnosis").json()["reference"] == "stage"
    periodic = [e for e in found["effects"] if e["name"] == "stage_periodic"]
    assert {e["origin"] for e in periodic} == {"stage"}
    assert any("good" in sentence and "0.00200°" in sentence for sentence in found["says"]), "it is suggested"
    assert {e["corrects"] for e in periodic} <= {"rig", None}
    assert {e["accepted_at"] for e in periodic} == {None}, "accepted as the sensor's, not as the stage's"
    assert bench.post(f"{url}/diagnosis", json={}).json()["reference"] == "good"


@pytest.mark.parametrize(
    ("body", "place"),
    [
        ({"reference": "perfect"}, "reference"),
        ({"periods": [0.0]}, "periods"),
        ({"periods": [360.5]}, "periods"),
        ({"periods": ["often"]}, "periods"),
        ({"periods": [7.2] * 21}, "periods"),
    ],
)
def test_what_cannot_be_assumed_is_refused(bench, traced, body, place):
    answer = bench.post(
        f"{traced[0]}/diagnosis", content=json.dumps(body), headers={"content-type": "application/json"}
    )
    assert answer.status_code == 422
    assert place in str(answer.json()).lower()


def test_an_encoder_that_counts_from_0_to_360_beside_a_reference_that_goes_on(bench):
    """A scale of 1.01 is 3.6° off where a reading is taken off its turn."""
    target_deg = np.linspace(258.0, 616.0, 60)
    reading_deg = (0.25 + 1.01 * (target_deg - 258.0)).round(4)
    rows = (f"{target},{reading}" for target, reading in zip(target_deg, reading_deg, strict=True))
    imported(bench, "EN-2", "\n".join(["target_deg,reading_deg", *rows]), rig="bench-1")
    document = bench.get("/api/units/EN-2/calibration?revision=latest").json()
    np.testing.assert_allclose(Calibration(document).elevation_deg(reading_deg), target_deg, atol=1e-3)
