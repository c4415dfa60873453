"""A solution's map put in force for a rig: runs rest on it from then on, and keep it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from kept_maps import STD_DEG, solved
from pydantic import TypeAdapter
from support import ended

from calrig.api.rigs import StageMapAnswer


@pytest.fixture
def store(service):
    return service.store


def calibrated(client, plan, unit="AS-1", **more):
    asked = {"unit": unit, "plan": {**plan.model_dump(exclude_unset=True), **more}}
    return ended(client, client.post("/api/runs", json=asked).raise_for_status().json()["id"])


def put(client, solve, **more):
    return client.post("/api/rigs/bench-1/map", json={"solve": solve, **more})


def test_a_map_in_force_is_what_runs_rest_on_and_keep(client, store, quick_plan):
    kept = store.solutions.save(solved(), by="ada")
    before = calibrated(client, quick_plan)
    assert client.get("/api/rigs/bench-1/map").status_code == 404
    shown = put(client, kept.id).raise_for_status().json()
    answer = client.get("/api/rigs/bench-1/map")
    assert answer.json() == shown
    (named,) = client.get("/api/stage-maps").json()
    assert (named["rig"], named["sha256"], named["solve"]) == ("bench-1", shown["sha256"], kept.id)
    TypeAdapter(StageMapAnswer).validate_json(answer.content, strict=True)
    assert (shown["solve"], shown["units"], shown["runs"]) == (kept.id, ["M-1"], ["a", "b", "c"])
    assert shown["covariance_deg2"][0][0] == STD_DEG**2
    assert shown["holds"]["state"] == "not_known"
    assert abs(np.mean(shown["map"]["error_deg"])) < 1e-12, "a constant is the mount's"

    ends = {"start_deg": -40, "stop_deg": 40}
    wanted = {"target_u_deg": 0.2, "trace": False, "plan": ends}
    designed = client.post("/api/plans/design", json=wanted).raise_for_status().json()
    assert 0.1 < designed["expected"]["expanded_uncertainty_deg"] <= 0.2
    for expanded_deg, status in ((0.2, 200), (0.001, 422)):
        until = {**ends, "until": {"expanded_uncertainty_deg": expanded_deg}}
        assert client.post("/api/plans/estimate", json={"plan": until}).status_code == status

    run = calibrated(client, quick_plan)
    assert run["provenance"]["stage_map"]["sha256"] == kept.found.stage_map["sha256"]
    stage, old = run["result"]["reference"], before["result"]["reference"]
    assert (stage["kind"], stage["distribution"], old["kind"]) == ("map", "normal", "harmonic")
    assert stage["std_deg"] < 2 * STD_DEG < old["std_deg"]
    assert run["result"]["over_range"]["expanded_uncertainty_deg"] < 0.2
    assert before["result"]["over_range"]["expanded_uncertainty_deg"] > 0.45
    revisions = client.get("/api/units/AS-1/calibration").json()
    assert revisions["uncertainty"]["reference"]["sha256"] == kept.found.stage_map["sha256"]
    assert "solved from 1 unit in 3 runs" in revisions["uncertainty"]["reference"]["says"]
    check = calibrated(client, quick_plan, kind="verification")
    assert check["result"]["reference"] == stage, "of the revision that it applied"

    beyond = calibrated(client, quick_plan, elevations_deg=[-80, 0, 40])
    assert beyond["result"]["reference"]["kind"] == "harmonic"
    assert any(
        "was not used: 2 poses stand at dial angles of −80° to −80°" in s for s in beyond["verdict"]["says"]
    )
    assert put(client, None, reason="the gear was changed").json() is None
    assert client.get("/api/rigs/bench-1/map").status_code == 404
    assert calibrated(client, quick_plan)["result"]["reference"]["kind"] == "harmonic"
    reason = {"reason": "somebody leant on the bench"}
    client.post(f"/api/runs/{run['id']}/poses/1/exclude", json=reason).raise_for_status()
    again = client.get(f"/api/runs/{run['id']}").json()["result"]["reference"]
    assert (again["kind"], again["std_deg"]) == ("map", pytest.approx(stage["std_deg"], rel=0.3))
    acts = client.get("/api/trail", params={"what": ["map_put_in_force", "map_withdrawn"]}).json()["entries"]
    assert [(a["what"], a["reason"]) for a in acts] == [
        ("map_put_in_force", None),
        ("map_withdrawn", "the gear was changed"),
    ]


def test_what_cannot_be_put_in_force_is_refused_with_the_reason(client, store):
    assert put(client, "other").status_code == 404
    assert put(client, None).status_code == 404, "there is none to withdraw"
    elsewhere = put(client, store.solutions.save(solved("bench-2")).id)
    assert (elsewhere.status_code, "is of rig 'bench-2'" in elsewhere.text) == (409, True)
    open_one = put(client, store.solutions.save(solved(separable=False)).id)
    assert open_one.status_code == 409
    detail = json.loads(open_one.text)["detail"]
    assert "do not part the stage" in detail
    assert "clamped at 0°, 120°, 240°" in detail, "what would help"


def test_a_limit_that_the_certificate_rules_out_can_be_passed_by_the_map(client, store):
    limit = {"name": "tight", "expanded_uncertainty_deg": 0.1}
    client.put("/api/limits", json=[limit]).raise_for_status()

    def warned():
        answer = client.post("/api/plans/estimate", json={"unit": "A", "plan": {}}).raise_for_status()
        return answer.json()["warnings"]

    assert "No unit can pass on this stage" in warned()[0]
    put(client, store.solutions.save(solved()).id).raise_for_status()
    assert warned() == []
