"""What a page elsewhere has a browser send: refused by the name it used, or by where it comes from."""

from __future__ import annotations

import httpx
import pytest
from support import run_async, running_service

from calrig.api.access import Access
from calrig.api.app import create_app
from calrig.api.origin_check import HEADERS, knows

OWN = "http://127.0.0.1:{port}"
STOP = "/api/rigs/bench-1/stop"


@pytest.fixture(scope="module")
def port(shared_client):
    return shared_client.base_url.port


@pytest.mark.parametrize(
    "name", ["127.0.0.1:{port}", "localhost:{port}", "LOCALHOST", "127.0.0.2:{port}", "[::1]:1"]
)
def test_on_loopback_the_names_of_this_machine_alone_are_known(shared_client, port, name):
    assert shared_client.get("/api/rigs", headers={"Host": name.format(port=port)}).status_code == 200


@pytest.mark.parametrize(
    "name",
    [
        "evil.example:{port}",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.168.1.5:{port}",
        "0.0.0.0:{port}",
        "localhost:{port}@evil.example",
        "",
    ],
)
@pytest.mark.parametrize("path", ["/", "/api/health", "/api/runs"])
def test_by_any_other_name_nothing_is_read(shared_client, port, name, path):
    """DNS rebinding: a name of the attacker's leads to this machine, and the browser sends that name."""
    answer = shared_client.get(path, headers={"Host": name.format(port=port)})
    assert answer.status_code == 403
    assert name.format(port=port) in answer.json()["detail"]
    assert "hosts = " in answer.json()["detail"]
    assert "127.0.0.1" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("host", "server", "known"),
    [
        ("192.168.1.5:8000", "192.168.1.5", True),
        ("192.168.1.5:8000", "::ffff:192.168.1.5", True),
        ("192.168.1.6:8000", "192.168.1.5", False),
        ("[fe80::1]:8000", "fe80::1", True),
        ("[fe80:0:0::1]:8000", "fe80::1", True),
        ("localhost:8000", "192.168.1.5", False),
        ("lab.example", "192.168.1.5", True),
        ("LAB.example:443", "127.0.0.1", True),
        ("other.example", "192.168.1.5", False),
        ("localhost:8000", "::ffff:127.0.0.1", True),
        ("lab.example", None, True),
        ("localhost", None, False),
    ],
)
def test_elsewhere_the_address_that_was_reached_and_the_names_told_are_known(host, server, known):
    assert knows(Access(names=frozenset({"lab.example"})), host, server) is known


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://localhost:{port}"},
        {"Origin": "http://127.0.0.1:{port}", "Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"},
    ],
    ids=lambda headers: " ".join(headers.values()),
)
@pytest.mark.parametrize(
    "kind",
    [
        "text/plain",
        "application/x-www-form-urlencoded",
        "multipart/form-data; boundary=x",
        "application/json",
    ],
)
def test_nothing_is_changed_from_a_page_elsewhere(shared_client, port, headers, kind):
    sent = {name: value.format(port=port) for name, value in headers.items()}
    for path in (STOP, "/api/runs", "/api/login"):
        answer = shared_client.post(path, content='{"unit": "A"}', headers={**sent, "Content-Type": kind})
        assert answer.status_code == 403
        assert "127.0.0.1" in answer.json()["detail"]
    assert shared_client.get("/api/runs").json()["items"] == []


@pytest.mark.parametrize(
    "headers",
    [{}, {"Origin": OWN}, {"Origin": OWN, "Sec-Fetch-Site": "same-origin"}, {"Sec-Fetch-Site": "none"}],
    ids=["a program", "the page, an old browser", "the page", "a person's own doing"],
)
def test_programs_and_the_page_itself_are_let_through(shared_client, port, headers):
    sent = {name: value.format(port=port) for name, value in headers.items()}
    assert shared_client.post(STOP, headers=sent).status_code == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_page_elsewhere_may_link_here_and_embed_nothing(shared_client, site):
    follow = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate"}
    assert shared_client.get("/", headers=follow).status_code == 200
    assert shared_client.get("/api/runs", headers={"Sec-Fetch-Site": site}).status_code == 403


@pytest.mark.parametrize(
    "kind", ["text/plain", "application/x-www-form-urlencoded", "", "text/plain; application/json"]
)
@pytest.mark.parametrize("path", ["/api/runs", "/api/login"])
def test_json_that_is_not_said_to_be_json_is_not_read_as_such(shared_client, kind, path):
    """What a form elsewhere can send without the browser asking first."""
    body = '{"unit": "A"}' if path == "/api/runs" else '{"token": "0123456789abcdef"}'
    answer = shared_client.post(path, content=body, headers={"Content-Type": kind})
    assert answer.status_code == 422


def test_a_browser_that_asks_first_is_told_nothing_that_would_let_it_go_on(shared_client):
    asks = {"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"}
    answer = shared_client.options(
        "/api/runs", headers={**asks, "Access-Control-Request-Headers": "content-type"}
    )
    assert answer.status_code >= 400
    assert not [name for name in answer.headers if name.startswith("access-control-")]


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/", 200),
        ("GET", "/web/app.css", 200),
        ("GET", "/api/rigs", 200),
        ("HEAD", "/web/main.js", 200),
        ("GET", "/nope", 404),
        ("PUT", "/api/runs", 405),
        ("POST", "/api/runs", 422),
    ],
)
def test_every_answer_carries_the_headers_and_none_of_cors(shared_client, method, path, status):
    answer = shared_client.request(method, path)
    assert answer.status_code == status
    assert {name: answer.headers[name] for name in HEADERS} == HEADERS
    assert not [name for name in answer.headers if name.startswith("access-control-")]


def test_refusals_and_failures_inside_carry_them_too(rig, store_path):
    with running_service(store_path, rig) as service:
        app = create_app(service)
        app.add_api_route("/api/defect", lambda: 1 / 0)

        async def asked(path, **headers):
            transport = httpx.ASGITransport(app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
                return await client.get(path, headers=headers)

        refused, failed = run_async(asked("/", Host="evil.example")), run_async(asked("/api/defect"))
    assert (refused.status_code, failed.status_code) == (403, 500)
    for answer in (refused, failed):
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS


def test_the_policy_allows_no_script_but_the_services_own_files():
    rules = dict(rule.split(" ", 1) for rule in HEADERS["Content-Security-Policy"].split("; "))
    assert rules["default-src"] == "'self'"
    assert "script-src" not in rules
    assert rules["frame-ancestors"] == rules["object-src"] == rules["base-uri"] == "'none'"
