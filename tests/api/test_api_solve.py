"""Runs of one rig solved together over HTTP: the solution is kept, listed, drawn; its map is put in force."""

from __future__ import annotations

import hashlib
import json
import re
import zipfile

import kept_maps
import numpy as np
import plotly.graph_objects as go
import pytest
from clamped import clamped, rows_of
from pydantic import TypeAdapter
from support import LONG, POSES, ended, imported, wait_for

from calrig.api import jobs
from calrig.api.rigs import StageMapAnswer
from calrig.export.archive.check import check_archive, solution_differences
from calrig.export.archive.layout import REVISIONS, run_names
from calrig.export.poses_csv import read_poses


@pytest.fixture(scope="module")
def runs(shared_client):
    """Of unit AS-7, clamped at three angles."""
    return [clamped(shared_client, "AS-7", angle)["id"] for angle in (0, 120, 240)]


@pytest.fixture(scope="module")
def solved(shared_client, runs):
    return shared_client.post("/api/solve", json={"runs": runs}).raise_for_status().json()


def hash_of(document):
    """As CONTRACT section 6 has it."""
    rest = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def test_a_solution_is_answered_and_kept(shared_client, runs, solved):
    assert solved["separable"]
    assert [mount["mount"] for mount in solved["mounts"]] == [
        f"{run_id[:8]} {angle}°" for run_id, angle in zip(runs, (0, 120, 240), strict=True)
    ]
    assert solved["final"]["held_out_rms_deg"] < 0.3 * solved["before"]["held_out_rms_deg"]
    path = f"/api/solve/{solved['id']}"
    assert shared_client.get(path).json() == solved
    on_rig = shared_client.get("/api/solve?rig=bench-1").json()
    (listed,) = (one for one in on_rig if one["id"] == solved["id"])
    assert listed == {name: solved[name] for name in listed if name != "units"} | {"units": ["AS-7"]}
    assert listed["runs"] == runs
    assert shared_client.get("/api/solve?rig=bench-2").json() == []


def test_calibrations_and_map_are_fetched_with_their_hashes(shared_client, solved):
    path = f"/api/solve/{solved['id']}"
    for of_it in ("units/AS-7", "map"):
        document = shared_client.get(f"{path}/{of_it}").json()
        assert (document["rig"], document["sha256"]) == ("bench-1", hash_of(document))
    assert shared_client.get(f"{path}/units/AS-8").status_code == 404
    for name in ("map", "before", "after"):
        figure = shared_client.get(f"{path}/figures/{name}").json()
        go.Figure(figure)  # raises on any property that plotly does not know
        assert len(figure["data"]) == 3 + 2 * (name == "map")


@pytest.mark.parametrize("body", [{"units": ["AS-7"]}, {"rig": "bench-1"}])
def test_all_that_counts_of_a_unit_or_on_a_rig_is_taken(shared_client, runs, solved, body):
    voided = clamped(shared_client, "AS-7", 45)["id"]
    shared_client.post(f"/api/runs/{voided}/void", json={"reason": "slipped"}).raise_for_status()
    again = shared_client.post("/api/solve", json=body).raise_for_status().json()
    assert again["runs"] == runs
    assert again["mounts"] == solved["mounts"]
    refused = shared_client.post("/api/solve", json={"runs": [voided], **body})
    assert (refused.status_code, "voided (slipped)" in refused.json()["detail"]) == (409, True)


def test_what_cannot_be_solved_is_refused_with_the_reason(shared_client, runs):
    elsewhere = clamped(shared_client, "AS-9", 0, rig="bench-2")["id"]
    few = imported(shared_client, "FEW", POSES)["id"]
    for body, status, words in (
        ({"runs": ["999"]}, 404, "there is no run 999"),
        ({"units": ["nobody"]}, 404, "there is no unit 'nobody'"),
        ({"rig": "bench-9"}, 404, "bench-9"),
        ({"runs": [runs[0], elsewhere]}, 409, "each stage has a map of its own"),
        ({"runs": runs, "rig": "bench-2"}, 409, "is of rig 'bench-1', not of 'bench-2'"),
        ({}, 422, "name runs, units or a rig"),
        ({"runs": runs, "periods_deg": [0.1]}, 422, "periods_deg"),
        ({"runs": runs, "gear": 7.2}, 422, "gear"),
        ({"runs": runs, "limits_deg": [90, -90]}, 422, "limits_deg is the lower, then the upper"),
        ({"runs": [few]}, 422, "4 poses are too few"),
        ({"units": ["AS-7"], "rig": "bench-2"}, 422, "no completed calibration that counts"),
    ):
        answer = shared_client.post("/api/solve", json=body)
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), answer.text
    assert shared_client.get("/api/solve/nothing").status_code == 404


def test_a_solution_becomes_a_revision_with_a_certificate_that_rests_on_gravity(
    shared_client, runs, solved, tmp_path
):
    limit = {"name": "flight", "units": "AS-7", "max_error_deg": 0.2, "rule": "guarded", "guard": 1.0}
    shared_client.put("/api/limits", json=[limit]).raise_for_status()
    path = "/api/units/AS-7/calibration"
    body = {"solve": solved["id"], "reason": "three mounts"}
    made = shared_client.post(f"{path}s", json=body).raise_for_status().json()
    assert (made["verdict"]["answer"], made["stale"], made["reason"]) == ("pass", [], "three mounts")
    document = shared_client.get(f"{path}?revision={made['revision']}").json()
    of_solution = shared_client.get(f"/api/solve/{solved['id']}/units/AS-7").json()
    for name in ("effects", "covariance", "expanded_uncertainty_deg", "elevation_std_deg", "range_deg"):
        assert document[name] == of_solution[name]
    assert (document["sha256"], document["run_id"]) == (hash_of(document), runs[0])
    assert document["provenance"]["solution"]["runs"] == runs
    file = tmp_path / "unit.zip"
    file.write_bytes(shared_client.get("/api/units/AS-7/archive").raise_for_status().content)
    found = check_archive(file)
    assert (found.problems, found.not_refitted) == ([], {})
    assert made["revision"] in found.refitted
    with zipfile.ZipFile(file) as archive:
        (basis,) = (
            one["solution"]
            for one in json.loads(archive.read(REVISIONS))
            if one["revision"] == made["revision"]
        )

        def run_of(run_id):
            run, poses = (archive.read(name) for name in run_names(run_id)[:2])
            poses = read_poses(poses).poses
            return json.loads(run), poses, list(range(len(poses)))

        assert list(solution_differences(document, basis, [], run_of)) == []
        parameters = document["effects"][0]["parameters"]
        forged = {**document["effects"][0], "parameters": {**parameters, "y_mg": parameters["y_mg"] + 0.01}}
        told = list(solution_differences({**document, "effects": [forged]}, basis, [], run_of))
        assert "effects" in " ".join(told)

    dcc = shared_client.get(f"{path}?revision=latest&format=dcc").text
    assert "joint solution of several mounts" in dcc
    assert "<dcc:traceable>false</dcc:traceable>" in dcc
    assert f"over 3 runs, solution {solved['id']}" in dcc
    assert all(warning in dcc for warning in solved["warnings"])
    assert re.search(r"Offset of y.{,400}Standard uncertainty 0\.0\d+ mg", dcc, re.S)
    left = re.search(r"Mean error as left.*?<si:valueXMLList>([^<]*)", dcc, re.S)
    assert max(abs(float(value)) for value in left[1].split()) < 0.05  # the stage's 0.3° is out of it

    for body, status, words in (
        ({"solve": solved["id"], "run_id": runs[0]}, 422, "a run or a solution"),
        ({"solve": solved["id"], "effects": []}, 422, "its own effects"),
        ({"reason": "none"}, 422, "a run or a solution"),
        ({"solve": "nothing"}, 404, "no solution"),
    ):
        answer = shared_client.post(f"{path}s", json=body)
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), answer.text


def test_a_plain_run_displaces_no_solution(shared_client):
    """Neither a good one, whose U is larger, nor one that was made while the clamp still stood elsewhere."""
    runs = [clamped(shared_client, "AS-6", angle)["id"] for angle in (0, 120, 240)]
    solution = shared_client.post("/api/solve", json={"runs": runs}).raise_for_status().json()["id"]
    path = "/api/units/AS-6/calibration"
    solved = shared_client.post(f"{path}s", json={"solve": solution}).raise_for_status().json()
    assert (solved["status"], solved["warnings"]) == ("in_force", [])
    good = clamped(shared_client, "AS-6", 0)
    rows = [row.split(",") for row in rows_of(240.0, 0)]
    forgotten = "\n".join(["target_deg,reading_deg", *(",".join(row[:2]) for row in rows)])
    elsewhere = imported(shared_client, "AS-6", forgotten, rig="bench-1")
    for run, kinds in (
        (good, {"solution_in_force"}),
        (elsewhere, {"solution_in_force", "changed", "clamping"}),
    ):
        assert {doubt["kind"] for doubt in run["result"]["doubts"]} == kinds
    newest, before, *_ = shared_client.get(f"{path}s").json()
    assert (newest["status"], before["status"]) == ("draft", "draft")
    assert shared_client.get(path).json()["revision"] == solved["revision"]


def test_what_a_revision_rests_on_and_counts_no_more_is_on_its_certificate(shared_client):
    runs = [clamped(shared_client, "AS-8", angle)["id"] for angle in (0, 120, 240)]
    solution = shared_client.post("/api/solve", json={"runs": runs}).raise_for_status().json()["id"]
    path = "/api/units/AS-8/calibration"
    made = shared_client.post(f"{path}s", json={"solve": solution}).raise_for_status().json()
    alone = shared_client.get(f"{path}s").json()[1]["revision"]  # of the last run by itself
    shared_client.post(f"/api/runs/{runs[0]}/note", json={"note": "by hand"}).raise_for_status()
    shared_client.post(f"/api/runs/{runs[1]}/poses/3/exclude", json={"reason": "bumped"}).raise_for_status()
    listed = shared_client.get(f"{path}s").json()
    assert (listed[0]["revision"], listed[0]["status"]) == (made["revision"], "in_force")
    assert listed[0]["stale"] == [f"Run {runs[1]} had poses excluded or included since it was solved."]
    shared_client.post(f"/api/runs/{runs[2]}/void", json={"reason": "slipped"}).raise_for_status()
    for revision in (made["revision"], alone):
        dcc = shared_client.get(f"{path}?revision={revision}&format=dcc").text
        assert re.search(rf"Run {runs[2]}.* voided: slipped", dcc)
    refused = shared_client.post(f"{path}s", json={"solve": solution})
    assert (refused.status_code, "Solve again" in refused.json()["detail"]) == (409, True)


def test_a_run_that_goes_on_is_not_solved(shared_client):
    begun = shared_client.post("/api/runs", json={"unit": "A", "plan": LONG}).json()
    answer = shared_client.post("/api/solve", json={"runs": [begun["id"]]})
    assert (answer.status_code, "end it first" in answer.json()["detail"]) == (409, True)
    shared_client.post(f"/api/runs/{begun['id']}/abort").raise_for_status()


def test_who_does_not_wait_has_a_job_that_says_where_the_solution_is(shared_client, runs, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    body = {"runs": runs, "linear": True}
    job = shared_client.post("/api/solve?wait=false", json=body).headers["Location"]
    wait_for(lambda: shared_client.get(job).json()["state"] == "done", "end")
    found = shared_client.get(shared_client.get(job).json()["result"]).json()
    assert (found["linear"], found["runs"]) == (True, runs)


@pytest.fixture
def store(service):
    return service.store


def calibrated(client, plan, unit="AS-1", **more):
    asked = {"unit": unit, "plan": {**plan.model_dump(exclude_unset=True), **more}}
    return ended(client, client.post("/api/runs", json=asked).raise_for_status().json()["id"])


def put(client, solve, **more):
    return client.post("/api/rigs/bench-1/map", json={"solve": solve, **more})


def test_a_map_in_force_is_what_runs_rest_on_and_keep(client, store, quick_plan):
    kept = store.solutions.save(kept_maps.solved(), by="ada")
    before = calibrated(client, quick_plan)
    assert client.get("/api/rigs/bench-1/map").status_code == 404
    shown = put(client, kept.id).raise_for_status().json()
    answer = client.get("/api/rigs/bench-1/map")
    assert answer.json() == shown
    (named,) = client.get("/api/stage-maps").json()
    assert (named["rig"], named["sha256"], named["solve"]) == ("bench-1", shown["sha256"], kept.id)
    TypeAdapter(StageMapAnswer).validate_json(answer.content, strict=True)
    assert (shown["solve"], shown["units"], shown["runs"]) == (kept.id, ["M-1"], ["a", "b", "c"])
    assert shown["covariance_deg2"][0][0] == kept_maps.STD_DEG**2
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
    assert stage["std_deg"] < 2 * kept_maps.STD_DEG < old["std_deg"]
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
    elsewhere = put(client, store.solutions.save(kept_maps.solved("bench-2")).id)
    assert (elsewhere.status_code, "is of rig 'bench-2'" in elsewhere.text) == (409, True)
    open_one = put(client, store.solutions.save(kept_maps.solved(separable=False)).id)
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
    put(client, store.solutions.save(kept_maps.solved()).id).raise_for_status()
    assert warned() == []
