"""Roles: what each may, who is told what they lack, and how a proxy names people."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support import NO_TLS, running_service, serving

from calrig.api import runs
from calrig.api.access import Access, access_of
from calrig.api.app import DOCUMENT
from calrig.settings import RigSettings, Settings
from calrig.store.users import ROLES

TOKEN = "the-benches-of-building-4"
NEEDED = {
    "/api/rigs/{name}/check-unit": "releaser",
    "/api/rigs/{name}/map": "admin",
    "/api/rigs/scan": "operator",
    "/api/rigs/{name}/clamp": "operator",
    "/api/runs": "operator",
    "/api/batches": "operator",
    "/api/batches/{batch_id}/units": "operator",
    "/api/batches/{batch_id}/remove": "operator",
    "/api/batches/{batch_id}/start": "operator",
    "/api/batches/{batch_id}/close": "operator",
    "/api/batches/{batch_id}/look": "operator",
    "/api/batches/read": "operator",
    "/api/runs/{run_id}/pause": "operator",
    "/api/runs/{run_id}/resume": "operator",
    "/api/runs/{run_id}/void": "releaser",
    "/api/runs/{run_id}/unvoid": "releaser",
    "/api/runs/{run_id}/note": "operator",
    "/api/runs/{run_id}/unit": "releaser",
    "/api/runs/{run_id}/poses/{index}/exclude": "operator",
    "/api/runs/{run_id}/poses/{index}/include": "operator",
    "/api/runs/{run_id}/diagnosis": "operator",
    "/api/runs/{run_id}/diagnosis/accept": "releaser",
    "/api/runs/{run_id}/diagnosis/withdraw": "releaser",
    "/api/units/{serial}": "releaser",
    "/api/units/{serial}/item": "operator",
    "/api/units/{serial}/calibrations": "operator",
    "/api/units/{serial}/calibrations/{revision}/release": "releaser",
    "/api/units/{serial}/calibrations/{revision}/withdraw": "releaser",
    "/api/units/{serial}/certificates": "releaser",
    "/api/runs/{run_id}/follow-up": "operator",
    "/api/imports": "operator",
    "/api/solve": "operator",
    "/api/limits": "admin",
    "/api/trail/backups": "operator",
    "/api/log-studies/{study_id}": "operator",
    "/api/jobs/{job_id}": "operator",
    "/api/users": "admin",
    "/api/users/{name}/token": "admin",
    "/api/users/{name}/role": "admin",
    "/api/users/{name}/disable": "admin",
    "/api/benches": "admin",
    "/api/benches/{name}": "admin",
}
"""The least role of every path that changes something; what is not listed is open to everybody known."""
HARMLESS = {
    "/api/plans/estimate",
    "/api/plans/design",
    "/api/noise",
    "/api/filters",
    "/api/login",
    "/api/logout",
}
SAFE = {"/api/rigs/{name}/stop", "/api/runs/{run_id}/abort"}
BY_CODE = {"/api/benches/enroll"}
"""Open to whoever has a bench's one-time code."""
CHANGING = [
    (method, path)
    for path, methods in json.loads(DOCUMENT.read_text(encoding="utf-8"))["paths"].items()
    for method in methods
    if method != "get" and path not in HARMLESS | BY_CODE
]


@pytest.fixture(scope="module")
def clients(rig: RigSettings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, httpx.Client]]:
    """A client for somebody of each role, called by it, and `token` for who has the service's one token."""
    path = tmp_path_factory.mktemp("roles") / "calrig.db"
    with running_service(path, rig) as service:
        tokens = {role: service.store.users.add(role, role)[1] for role in ROLES}
        with serving(service, access=Access(TOKEN, patience_s=0.1)) as client:
            clients = {
                name: httpx.Client(
                    base_url=client.base_url, headers={"Authorization": f"Bearer {token}"}, verify=NO_TLS
                )
                for name, token in {**tokens, "token": TOKEN}.items()
            }
            yield clients
            for one in clients.values():
                one.close()


def test_every_path_that_changes_something_has_its_role() -> None:
    assert {path for _, path in CHANGING} == set(NEEDED) | SAFE


@pytest.mark.parametrize(("method", "path"), CHANGING)
def test_a_path_is_open_from_its_role_on_and_says_who_may_not_and_which_role_may(
    clients: dict[str, httpx.Client], monkeypatch: pytest.MonkeyPatch, method: str, path: str
) -> None:
    monkeypatch.setattr(runs.ports, "scan", lambda *, ours: [])
    withdraws_stop = method == "delete" and path in SAFE
    needed = "operator" if withdraws_stop else NEEDED.get(path, "viewer")
    enough = ROLES.index(needed)
    for role in ROLES:
        answer = clients[role].request(method, re.sub(r"{.*?}", "0", path), json={})
        if ROLES.index(role) >= enough:
            assert answer.status_code != 403, answer.text
        else:
            assert answer.status_code == 403
            assert f"{role} ({role}) may not do this" in answer.json()["detail"]
            assert f"the role {needed}" in answer.json()["detail"]


@pytest.mark.parametrize("name", [*ROLES, "token"])
def test_everybody_known_reads_and_stops(clients: dict[str, httpx.Client], name: str) -> None:
    assert clients[name].get("/api/runs").status_code == 200
    assert clients[name].post("/api/rigs/bench-1/stop").status_code == 200


def test_who_logs_in_is_told_as_whom(clients: dict[str, httpx.Client]) -> None:
    answer = clients["viewer"].get("/api/login").json()
    assert (answer["name"], answer["role"], answer["logged_in"]) == ("viewer", "viewer", True)
    answer = clients["token"].get("/api/login").json()
    assert (answer["name"], answer["role"], answer["logged_in"]) == (None, "admin", True)


class TestWithoutTheOneToken:
    """On loopback."""

    def test_anybody_is_admin_until_an_admin_is_known_by_name(self, service: Any) -> None:
        service.store.users.add("ada", "operator")
        with serving(service) as client:
            assert client.post("/api/runs/1/void", json={"reason": "slipped"}).status_code == 404
        service.store.users.add("ben", "admin")
        with serving(service) as client:
            assert client.get("/api/runs").status_code == 401

    def test_a_token_that_nobody_has_is_refused_once_there_are_users(self, service: Any) -> None:
        _, token = service.store.users.add("ada", "viewer")
        service.store.users.add("ben", "operator")
        service.store.users.disable("ben")
        with serving(service, access=Access(patience_s=0.05)) as client:
            assert client.get("/api/runs", headers={"Authorization": "Bearer bens"}).status_code == 401
            ada = {"Authorization": f"Bearer {token}"}
            assert client.post("/api/imports", headers=ada, json={}).status_code == 403


def test_an_admin_keeps_users_and_what_changes_holds_from_the_next_request_on(service: Any) -> None:
    with (
        serving(service, access=Access(TOKEN, patience_s=0.05)) as client,
        httpx.Client(base_url=client.base_url, verify=NO_TLS) as browser,
    ):
        client.headers["Authorization"] = f"Bearer {TOKEN}"
        added = client.post("/api/users", json={"name": "ada", "role": "operator"})
        assert added.status_code == 201
        browser.post("/api/login", json={"token": added.json()["token"]}).raise_for_status()
        assert browser.get("/api/login").json()["name"] == "ada"
        assert browser.post("/api/runs/0/pause").status_code == 404
        client.post("/api/users/ada/role", json={"role": "viewer"}).raise_for_status()
        assert browser.post("/api/runs/0/pause").status_code == 403
        assert browser.get("/api/users").status_code == 403
        token = client.post("/api/users/ada/token").raise_for_status().json()["token"]
        assert browser.get("/api/runs").status_code == 401
        ada = {"Authorization": f"Bearer {token}"}
        assert browser.get("/api/runs", headers=ada).status_code == 200
        client.post("/api/users/ada/disable").raise_for_status()
        assert browser.get("/api/runs", headers=ada).status_code == 401
        listed = client.get("/api/users").json()
        assert [(user["name"], user["role"], user["has_token"]) for user in listed] == [
            ("ada", "viewer", False)
        ]
        assert "sha256" not in str(listed)


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("", {"name": "a b", "role": "viewer"}, 422),
        ("", {"name": "ada", "role": "king"}, 422),
        ("", {"name": "root", "role": "viewer"}, 409),
        ("/eve/token", {}, 404),
        ("/root/disable", {}, 409),
        ("/root/role", {"role": "viewer"}, 409),
    ],
)
def test_what_cannot_be_done_to_users_is_said(
    service: Any, path: str, body: dict[str, str], status: int
) -> None:
    _, token = service.store.users.add("root", "admin")
    with serving(service) as client:
        root = {"Authorization": f"Bearer {token}"}
        assert client.post(f"/api/users{path}", json=body, headers=root).status_code == status


PROXIED = Settings(trusted_proxies=("127.0.0.0/8",), user_header="X-Auth-Name")


def behind(service: Any, settings: Settings) -> Any:
    """The service as a proxy reaches it, without a token of its own."""
    return serving(
        service, access=access_of(None, host="h", bound_to="127.0.0.1", settings=settings, own_name="h")
    )


class TestBehindAProxy:
    """That names whom it lets in."""

    def test_whom_it_names_comes_in_with_their_role(self, service: Any) -> None:
        service.store.users.add("ada@lab", "viewer", with_token=False)
        with behind(service, PROXIED) as client:
            ada = {"X-Auth-Name": "ada@lab"}
            assert client.get("/api/runs", headers=ada).status_code == 200
            assert client.get("/api/login", headers=ada).json()["name"] == "ada@lab"
            assert "ada@lab (viewer)" in client.post("/api/runs", headers=ada, json={}).json()["detail"]

    def test_a_token_of_ones_own_says_more_and_the_one_token_says_less(self, service: Any) -> None:
        service.store.users.add("ada", "viewer", with_token=False)
        _, bens = service.store.users.add("ben", "operator")
        with serving(service, access=Access(TOKEN, proxies=PROXIED.trusted_proxies)) as client:

            def name(header: str, token: str) -> tuple[str | None, str | None]:
                headers = {"X-Forwarded-User": header, "Authorization": f"Bearer {token}"}
                answer = client.get("/api/login", headers={k: v for k, v in headers.items() if v}).json()
                return answer["name"], answer["role"]

            assert name("ada", TOKEN) == ("ada", "viewer")
            assert name("ada", bens) == ("ben", "operator")
            assert name("", TOKEN) == (None, "admin")
            assert name("eve", TOKEN) == (None, None)

    def test_who_was_disabled_comes_in_no_more(self, service: Any) -> None:
        service.store.users.add("ada", "viewer", with_token=False)
        service.store.users.disable("ada")
        with behind(service, PROXIED) as client:
            assert client.get("/api/runs", headers={"X-Auth-Name": "ada"}).status_code == 403

    def test_nobody_else_comes_in_and_each_is_told_why(self, service: Any) -> None:
        service.store.users.add("ada", "viewer", with_token=False)
        with behind(service, PROXIED) as client:
            assert client.get("/api/runs").status_code == 401
            answer = client.get("/api/runs", headers={"X-Auth-Name": "eve"})
            assert (answer.status_code, "calrig users add" in answer.json()["detail"]) == (403, True)
            twice = [("X-Auth-Name", "ada"), ("X-Auth-Name", "ada")]
            assert client.get("/api/runs", headers=twice).status_code == 401
            other_header = {"X-Forwarded-User": "ada"}
            assert client.get("/api/runs", headers=other_header).status_code == 401

    @pytest.mark.parametrize("claimed", [{}, {"X-Forwarded-For": "10.0.0.1"}])
    def test_from_any_other_address_the_header_says_nothing(
        self, service: Any, claimed: dict[str, str]
    ) -> None:
        service.store.users.add("ada", "admin", with_token=False)
        with behind(service, Settings(trusted_proxies=("10.0.0.0/24",))) as client:
            assert client.get("/api/runs", headers={"X-Forwarded-User": "ada", **claimed}).status_code == 401
