"""The bench's own page: it looks, starts and stops, and refuses what only the centre may do."""

from __future__ import annotations

import pytest
from support import QUICK, ended, running_service, serving

from calrig.api.access import Access


@pytest.fixture
def client(rig, spool):
    with (
        running_service(spool, rig.settings) as service,
        serving(service, is_bench=True, access=Access(token="a-token-of-the-bench")) as client,
    ):
        client.headers["Authorization"] = "Bearer a-token-of-the-bench"
        yield client


def test_it_starts_shows_and_stops_runs(client) -> None:
    run = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).raise_for_status().json()
    assert ended(client, run["id"])["status"] == "completed"
    assert client.post("/api/rigs/bench-1/stop").status_code == 200
    assert client.get("/api/units/AS-1").status_code == 200


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/api/runs/1/void"),
        ("POST", "/api/runs/1/diagnosis"),
        ("POST", "/api/units/AS-1/calibrations/1/release"),
        ("PUT", "/api/limits"),
        ("POST", "/api/imports"),
        ("POST", "/api/users"),
        ("DELETE", "/api/units/AS-1"),
    ],
)
def test_it_leaves_the_rest_to_the_centre(client, method: str, path: str) -> None:
    refused = client.request(method, path, json={})
    assert refused.status_code == 409
    assert "centre" in refused.json()["detail"]


def test_it_asks_for_its_token_and_who_sent_the_page(client) -> None:
    assert client.post("/api/rigs/bench-1/stop", headers={"Authorization": ""}).status_code == 401
    elsewhere = {"Origin": "http://elsewhere.example"}
    assert client.post("/api/rigs/bench-1/stop", headers=elsewhere).status_code == 403
