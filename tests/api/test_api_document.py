"""The OpenAPI document: kept with the source, equal to the application's, and true of what it answers."""

from __future__ import annotations

import json

import pytest
from clamped import clamped
from pydantic import TypeAdapter
from support import QUICK, ended

from calrig.api import jobs
from calrig.api.app import DOCUMENT, PARTS
from calrig.api.openapi import document

CSV = "target_deg,reading_deg,supply_v\n-30,-29.5,3.3\n0,0.4,\n30,30.6,3.2\n"


def test_the_document_kept_is_the_applications_own():
    kept = json.loads(DOCUMENT.read_text(encoding="utf-8"))
    assert kept == document(), "run `python -m calrig.api.openapi` and commit what it writes"


def test_every_answer_is_what_the_document_says(shared_client, monkeypatch):
    """The document is made from the answers' models; each JSON answer must fit its own one to the letter."""
    plan = {**QUICK, "sweeps": 4}
    begun = shared_client.post("/api/runs", json={"unit": "A/1", "plan": plan, "operator": "Ada"})
    run_id = begun.json()["id"]
    assert ended(shared_client, run_id)["status"] == "completed"
    assert shared_client.post(f"/api/runs/{run_id}/diagnosis", json={}).status_code == 200
    still = {"kind": "static", "dwell_s": 20.0}
    static_id = shared_client.post("/api/runs", json={"unit": "A/1", "plan": still}).json()["id"]
    assert ended(shared_client, static_id)["status"] == "completed"
    shared_client.put("/api/rigs/bench-1/check-unit", json={"unit": "A/1", "interval_days": 7})
    mounts = [clamped(shared_client, "A/1", angle)["id"] for angle in (0, 120, 240)]
    solution = shared_client.post("/api/solve", json={"runs": mounts}).json()
    rows = "\n".join(f"{k / 100},{0.01 * (k % 7 - 3)},{1 + 0.01 * (k % 5 - 2)}" for k in range(500))
    log = {"file": ("log.csv", f"time_s,accel_y_g,accel_z_g\n{rows}\n")}
    study = shared_client.post("/api/noise", files=log).raise_for_status().json()
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)  # for a job
    file = {"file": ("poses.csv", CSV)}
    job = shared_client.post("/api/imports?wait=false", files=file, data={"unit": "B"}).json()
    routes = [route for part in PARTS for route in part.router.routes if "GET" in route.methods]
    models = {route.path: route.response_model for route in routes if route.response_model is not None}
    del models["/api/rigs/{name}/map"]  # it takes a solution: tests/api/test_api_stage_map.py
    names = {
        "/api/rigs/{name}/error-map": "bench-1",
        "/api/rigs/{name}/check-unit": "bench-1",
        "/api/rigs/{name}/figures/check-unit": "bench-1",
        "/api/rigs/{name}/figures/error-map": "bench-1",
        "/api/runs/{run_id}/figures/{name}": "residual",
        "/api/compare/figures/{name}": "bias",
        "/api/solve/{solution_id}/figures/{name}": "map",
    }
    for path, model in models.items():
        told_by = static_id if path.endswith("/noise") else run_id
        url = path.replace("{run_id}", told_by).replace("{serial:path}", "A/1")
        url = url.replace("{job_id}", job["id"]).replace("{solution_id}", solution["id"])
        url = url.replace("{study_id}", study["id"])
        answer = shared_client.get(url.replace("{name}", names.get(path, "")))
        assert answer.status_code == 200, url
        TypeAdapter(model).validate_json(answer.content, strict=True)
    assert len(models) >= 12
    # Both kinds of run, and a pose with a covariate, are among what was checked.
    (imported,) = shared_client.get("/api/runs?unit=B").json()["items"]
    run = shared_client.get(f"/api/runs/{imported['id']}").content
    TypeAdapter(models["/api/runs/{run_id}"]).validate_json(run, strict=True)
    poses = shared_client.get(f"/api/runs/{imported['id']}/poses").content
    TypeAdapter(models["/api/runs/{run_id}/poses"]).validate_json(poses, strict=True)


@pytest.mark.parametrize("path", ["/docs", "/redoc"])
def test_no_page_that_loads_scripts_from_another_host_is_served(shared_client, path):
    assert shared_client.get(path).status_code == 404
