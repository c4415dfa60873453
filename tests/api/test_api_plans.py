"""What a plan comes to, asked over HTTP before anything is started."""

from __future__ import annotations

import pytest
from support import imported


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
        (
            {"plan": {"until": {"expanded_uncertainty_deg": 0.3, "bias_std_deg": 0.1}}},
            422,
            "cannot be reached: the stage's uncertainty alone makes it 0.477°",
        ),
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


def test_a_field_without_a_name_makes_no_header_that_a_server_may_not_send(shared_client):
    answer = shared_client.post("/api/plans/estimate", json={"": {}, "\t": 3, "stop": 1})
    assert (answer.status_code, answer.headers["Calrig-Fields"]) == (422, "%09 stop")
    assert "Calrig-Fields" not in shared_client.post("/api/plans/estimate", json={"": {}}).headers


@pytest.mark.parametrize(
    "path", ["/api/plans/estimate", "/api/runs/{run}/diagnosis/accept", "/api/benches/enroll"]
)
@pytest.mark.parametrize("body", [{"": {}}, [], "no object", None])
def test_a_body_with_nothing_to_name_is_refused_and_the_connection_lives_on(shared_client, path, body):
    run = imported(shared_client, "AS-7")
    answer = shared_client.post(path.format(run=run["id"]), json=body)
    assert answer.status_code == 422
    assert "" not in answer.headers.get("Calrig-Fields", "none").split(" ")
    assert shared_client.get("/api/health").is_success


def test_a_plan_is_designed_for_an_uncertainty_and_a_run_takes_it(shared_client):
    wanted = {"target_u_deg": 0.5, "plan": {"start_deg": -40, "stop_deg": 40}}
    told = shared_client.post("/api/plans/design", json=wanted).raise_for_status().json()
    assert told["expected"]["expanded_uncertainty_deg"] <= 0.5
    assert told["limit"]["duration_s"] <= told["expected"]["duration_s"]
    assert {one["name"] for one in told["suspects"]} >= {"backlash", "settling", "mount_slip"}
    estimated = (
        shared_client.post("/api/plans/estimate", json={"plan": told["plan"]}).raise_for_status().json()
    )
    assert estimated["duration_s"] == pytest.approx(told["expected"]["duration_s"], abs=0.5)
    assert (min(estimated["elevations_deg"]), max(estimated["elevations_deg"])) == (-40, 40)


def test_a_plan_for_a_time_says_in_how_little_as_much_could_be_reached(shared_client):
    told = shared_client.post("/api/plans/design", json={"time_s": 120}).raise_for_status().json()
    limit = told["limit"]
    assert 60 < limit["duration_s"] <= told["expected"]["duration_s"] <= 120
    assert "this plan's uncertainty" in limit["why"]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"target_u_deg": 0.1}, "cannot be reached"),
        ({"time_s": 3}, "3 s are too few"),
        ({}, "what is to be reached (target_u_deg, until) or a time"),
        ({"target_u_deg": 0.5, "time_s": 60}, "what is to be reached (target_u_deg, until) or a time"),
        ({"target_u_deg": 0.5, "plan": {"elevations_deg": [0]}}, "has no scale"),
    ],
)
def test_what_no_plan_reaches_is_refused_with_the_reason(shared_client, wanted, words):
    answer = shared_client.post("/api/plans/design", json=wanted)
    assert answer.status_code == 422
    assert words in answer.json()["detail"]


def test_a_plan_of_several_mounts_says_how_the_seats_must_lie_before_the_run(shared_client):
    plans = [{}, {"mounts_deg": [0, 120, 240]}]
    one, three = (
        shared_client.post("/api/plans/estimate", json={"plan": plan}).raise_for_status().json()["warnings"]
        for plan in plans
    )
    (said,) = (sentence for sentence in three if sentence not in one)
    assert "x axis must lie along the stage's axis" in said
    assert "`accel_x` is not used" in said
