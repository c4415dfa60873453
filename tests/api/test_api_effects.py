"""The catalogue of effects over HTTP, and a unit whose effect is steep: answers in words, never a failure."""

from __future__ import annotations

import numpy as np
import pytest
from support import imported

from calrig.calibration.effects import EFFECTS


def test_the_catalogue_says_all_that_a_page_shows_of_an_effect(shared_client):
    effects = shared_client.get("/api/effects").raise_for_status().json()
    assert [effect["name"] for effect in effects] == list(EFFECTS)
    (backlash,) = (effect for effect in effects if effect["name"] == "backlash")
    hysteresis = {"name": "backlash_deg", "title": "Hysteresis (up − down)", "unit": "°", "flag": False}
    units = {parameter["name"]: parameter["unit"] for parameter in backlash["parameters"]}
    assert backlash["parameters"][0] == hysteresis
    assert units["growth_deg_per_deg"] == "°/°"
    assert {units[name] for name in ("backlash_deg", "middle_deg", "yield_deg")} == {"°"}
    assert (backlash["scope"], backlash["origin_title"]) == ("rig", "the stage")
    assert (backlash["covariate"], backlash["covariate_title"]) == ("approach", "approach")


def with_a_scale_that_moves(client, unit, per_c):
    """The address of a unit with a calibration whose scale follows temperature, that effect accepted."""
    rng = np.random.default_rng(4)
    theta = rng.uniform(-60, 60, 60).round(2)
    celsius = rng.uniform(21.0, 29.0, 60).round(2)
    reading = 0.8 + theta * (1.0 + per_c * (celsius - 25.0)) + rng.normal(0, 0.01, 60)
    rows = (f"{x},{y:.4f},{t}" for x, y, t in zip(theta, reading, celsius, strict=True))
    run = imported(client, unit, "\n".join(["target_deg,reading_deg,temperature_c", *rows]))
    url = f"/api/runs/{run['id']}"
    (effect,) = client.post(f"{url}/diagnosis", json={}).raise_for_status().json()["effects"]
    assert effect["name"] == "temperature_scale"
    client.post(f"{url}/diagnosis/accept", json={"effects": [effect["name"]]}).raise_for_status()
    return f"/api/units/{unit}/calibration"


def test_a_scale_that_moves_by_more_than_a_percent_a_degree_is_put_into_c(shared_client):
    url = with_a_scale_that_moves(shared_client, "STEEP-1", 0.014)
    (effect,) = shared_client.get(url).raise_for_status().json()["effects"]
    assert effect["formula"] == EFFECTS["temperature_scale"].formula
    assert effect["parameters"]["per_c"] == pytest.approx(0.014, abs=1e-4)
    header = shared_client.get(url, params={"format": "c-header"}).raise_for_status().text
    assert "calrig_elevation_deg" in header


def test_a_correction_too_steep_for_one_elevation_a_reading_is_refused_in_words(shared_client):
    url = with_a_scale_that_moves(shared_client, "STEEP-2", 0.23)
    answer = shared_client.get(url, params={"format": "c-header"})
    assert answer.status_code == 409
    assert "temperature_scale" in answer.json()["detail"]
    assert "not a small correction" in answer.json()["detail"]
