"""What the API answers is kept by no browser and no proxy; the page's own files are."""

from __future__ import annotations

import httpx
import pytest
from support import imported, run_async, running_service

from calrig.api.access import Access
from calrig.api.app import create_app


@pytest.fixture(scope="module")
def run_id(shared_client):
    return imported(shared_client, "AS-1")["id"]


@pytest.mark.parametrize(
    "path",
    [
        "/api/health",
        "/api/rigs",
        "/api/runs",
        "/api/runs/{id}",
        "/api/runs/{id}/events",
        "/api/runs/{id}/poses",
        "/api/runs/{id}/poses?format=csv",
        "/api/runs/{id}/samples",
        "/api/runs/{id}/transcript",
        "/api/runs/{id}/figures/residual",
        "/api/units",
        "/api/compare",
        "/api/effects",
        "/api/metrics",
        "/api/openapi.json",
        "/api/runs/99",
        "/api/no-such-path",
    ],
)
def test_no_answer_of_the_api_is_kept(shared_client, run_id, path):
    answer = shared_client.get(path.format(id=run_id))
    assert answer.headers.get_list("cache-control") == ["no-store"]


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE"])
def test_nor_one_to_another_method(shared_client, method):
    assert shared_client.request(method, "/api/runs").headers["cache-control"] == "no-store"


def test_nor_refusals_and_failures_inside(rig, store_path):
    with running_service(store_path, rig) as service:
        app = create_app(service, access=Access(token="a-token-of-sixteen"))
        app.add_api_route("/api/defect", lambda: 1 / 0)

        async def asked(path: str, **headers: str) -> httpx.Response:
            transport = httpx.ASGITransport(app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
                return await client.get(path, headers=headers)

        answers = [
            run_async(asked("/api/runs", Host="evil.example")),
            run_async(asked("/api/runs")),
            run_async(asked("/api/defect", Authorization="Bearer a-token-of-sixteen")),
        ]
    assert [answer.status_code for answer in answers] == [403, 401, 500]
    assert [answer.headers["cache-control"] for answer in answers] == ["no-store"] * 3


def test_the_pages_files_are_kept_all_the_same(shared_client):
    page = shared_client.get("/")
    assert page.headers["cache-control"] == "no-cache"
    main = page.text.split('src="')[1].split('"')[0]
    assert "immutable" in shared_client.get(main).headers["cache-control"]
