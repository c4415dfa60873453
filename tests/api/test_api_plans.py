"""What a plan comes to, asked over HTTP before anything is started."""

from __future__ import annotations

import pytest


def test_the_default_plan_is_told_for_the_first_rig(shared_client):
    told = shared_client.post("/api/plans/estimate", json={}).raise_for_status().json()
    assert told["n_poses"] == 52
    assert told["elevations_deg"] == list(range(-60, 61, 10))
    assert told["duration_s"] > 52 * 3.0


@pytest.mark.parametrize(
    ("body", "code", "words"),
    [
        ({"plan": {"stop_deg": 120}}, 422, "elevation 100° is beyond the rig's soft limits"),
        ({"plan": {"sweeps": 9999}}, 422, "the most a run takes is 10000"),
        ({"plan": {"step_deg": None}}, 422, "Step is not a number"),
        ({"rig": "elsewhere"}, 404, "no rig 'elsewhere'"),
    ],
)
def test_a_plan_that_a_run_would_be_refused_for_is_refused_alike(shared_client, body, code, words):
    for path in ("/api/plans/estimate", "/api/runs"):
        unit = {"unit": "AS-1"} if path == "/api/runs" else {}
        answer = shared_client.post(path, json={**body, **unit})
        assert list(answer.json()) == ["detail"]
        assert answer.status_code == code
        assert words in answer.json()["detail"]


@pytest.mark.parametrize(
    ("plan", "places"),
    [
        ({"sweeps": "x", "elevations_deg": [0, "ten"]}, "plan.elevations_deg[1] plan.sweeps"),
        ({"stop_deg": 120}, "plan.stop_deg"),
        ({"elevations_deg": [0, 95, 10, -91]}, "plan.elevations_deg[1] plan.elevations_deg[3]"),
        ({"so viel?": 1}, "plan.so%20viel%3F"),
    ],
)
def test_a_refusal_names_the_places_for_whoever_marks_them(shared_client, plan, places):
    answer = shared_client.post("/api/plans/estimate", json={"plan": plan})
    assert (answer.status_code, answer.headers["Calrig-Fields"]) == (422, places)
