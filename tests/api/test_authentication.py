"""The token: what is open without it, how programs and people show it, and what a wrong one gets."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import subprocess
import sys

import httpx
import pytest
from command_line import reason
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from support import NO_TLS, run_async, running_service, serving

from calrig.api.access import Access, AccessError, access_here
from calrig.api.app import DOCUMENT
from calrig.api.authentication import (
    MOST_OF_A_TOKEN,
    MOST_SESSIONS,
    SESSION_S,
    WAITING_EACH,
    Authentication,
    Sessions,
)
from calrig.settings import Settings
from calrig.store.users import token_digest

TOKEN = "the-benches-of-building-4"
BEARER = {"Authorization": f"Bearer {TOKEN}"}
OPEN = {
    ("get", "/api/health"),
    ("get", "/api/login"),
    ("post", "/api/login"),
    ("post", "/api/benches/enroll"),  # by its code, which is the proof
}
STRANGER = {"needed": True, "logged_in": False, "name": None, "role": None, "session": False}
PATHS = json.loads(DOCUMENT.read_text(encoding="utf-8"))["paths"]
EVERYTHING = [(method, path) for path, item in PATHS.items() for method in item]


@pytest.fixture(scope="module")
def asking(rig, tmp_path_factory):
    """A client of a service with a token; it does not show it by itself and keeps no cookies."""
    path = tmp_path_factory.mktemp("asking") / "calrig.db"
    with (
        running_service(path, rig) as service,
        serving(service, access=Access(TOKEN, patience_s=0.3)) as client,
    ):
        yield client


@pytest.fixture
def person(asking):
    """A browser, as far as cookies go."""
    with httpx.Client(base_url=asking.base_url, verify=NO_TLS) as client:
        yield client


@pytest.mark.parametrize(
    ("method", "path"),
    [
        *sorted(set(EVERYTHING) - OPEN),
        ("get", "/api/openapi.json"),
        ("get", "/api/metrics"),
        ("get", "/nope"),
    ],
)
def test_without_a_token_everything_is_401_and_says_who_is_meant_and_how_to_come_in(asking, method, path):
    answer = asking.request(method, re.sub(r"{.*?}", "1", path))
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"] == "Bearer"
    detail = answer.json()["detail"]
    assert method.upper() in detail
    assert "127.0.0.1" in detail
    assert "Authorization: Bearer" in detail


@pytest.mark.parametrize(
    "path", ["/", "/web/main.js", "/web/vendor/plotly-partial.min.js", "/api/health", "/api/login"]
)
def test_the_page_its_login_and_the_health_are_open(asking, path):
    assert asking.get(path).status_code == 200


def test_a_program_sends_the_token_with_each_request(asking):
    assert asking.get("/api/rigs", headers=BEARER).json()[0]["name"] == "bench-1"
    assert asking.post("/api/rigs/bench-1/stop", headers=BEARER).status_code == 200


@pytest.mark.parametrize(
    "shown", ["Bearer the-wrong-one-entirely", "Bearer", f"Basic {TOKEN}", TOKEN, "Bearer ü"]
)
def test_anything_else_in_its_place_is_401(asking, shown):
    answer = asking.get("/api/rigs", headers={"Authorization": shown.encode()})
    assert answer.status_code == 401
    assert TOKEN not in answer.text


def test_a_wrong_token_is_logged_without_being_written_down(asking, caplog):
    asking.post("/api/login", json={"token": "my-other-password-1"})
    assert "wrong token from 127.0.0.1" in caplog.text
    assert "my-other-password-1" not in caplog.text


def test_among_many_wrong_tokens_who_has_the_right_one_or_a_session_comes_in_at_once():
    authentication = Authentication(Access(TOKEN, patience_s=3600.0))
    session = authentication.sessions.begin(token_digest(TOKEN))
    outside, inside = asked_for("/api/rigs"), asked_for("/api/rigs", cookie=f"calrig_session_80={session}")

    async def status_of(check):
        try:
            await check
        except HTTPException as error:
            return error.status_code, (error.headers or {}).get("Retry-After")
        return 200, None

    async def crowd():
        waiting = [
            asyncio.create_task(status_of(authentication.check_token(outside, f"guess {k}")))
            for k in range(WAITING_EACH)
        ]
        await asyncio.sleep(0)  # all of them wait, for longer than this test does
        at_once = [
            await status_of(authentication.check_token(outside, "one more guess")),
            await status_of(authentication.check_token(outside, TOKEN)),
            await status_of(authentication.check(asked_for("/api/rigs", authorization=f"Bearer {TOKEN}"))),
            await status_of(authentication.check(inside)),
        ]
        for guess in waiting:
            guess.cancel()
        return at_once

    assert run_async(crowd()) == [(429, "1"), (200, None), (200, None), (200, None)]


def test_a_wrong_token_is_401_after_its_wait():
    authentication = Authentication(Access(TOKEN, patience_s=0.01))
    with pytest.raises(HTTPException) as refused:
        run_async(authentication.check_token(asked_for("/api/login"), "a wrong token, all in all"))
    assert refused.value.status_code == 401


def asked_for(path, **headers):
    """A request from one address, as the server hands it on."""
    return HTTPConnection(
        {
            "type": "http",
            "method": "GET",
            "path": path,
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
            "client": ("192.168.1.9", 40000),
            "server": ("192.168.1.5", 80),
        }
    )


def test_a_person_logs_in_and_gets_a_cookie_that_is_not_the_token_and_no_script_reads(asking, person):
    assert person.get("/api/login").json() == STRANGER
    answer = person.post("/api/login", json={"token": TOKEN})
    cookie = answer.headers["set-cookie"]
    assert TOKEN not in cookie
    for flag in ("HttpOnly", "SameSite=strict", "Path=/", f"Max-Age={SESSION_S:.0f}"):
        assert flag in cookie
    assert "Secure" not in cookie
    assert person.get("/api/login").json() == {
        **STRANGER,
        "logged_in": True,
        "role": "admin",
        "session": True,
    }
    assert person.get("/api/rigs").status_code == 200


def test_behind_a_proxy_with_tls_the_cookie_is_for_https_alone(asking):
    by_proxy = {"X-Forwarded-Proto": "https"}
    answer = httpx.post(asking.base_url.join("/api/login"), json={"token": TOKEN}, headers=by_proxy)
    assert "Secure" in answer.headers["set-cookie"]


def test_logging_out_ends_the_session_also_for_a_copy_of_its_cookie(asking, person):
    person.post("/api/login", json={"token": TOKEN}).raise_for_status()
    copied = dict(person.cookies)
    assert person.post("/api/logout").json() == STRANGER
    assert not person.cookies
    again = httpx.get(asking.base_url.join("/api/rigs"), cookies=copied)
    assert again.status_code == 401
    assert "the session has ended" in again.json()["detail"]


def test_a_session_ends_after_a_days_work():
    now_s = 1000.0
    sessions = Sessions(clock=lambda: now_s)
    value = sessions.begin("digest")
    now_s += SESSION_S - 1
    assert sessions.token_of(value) == "digest"
    now_s += 2
    assert sessions.token_of(value) is None


def test_the_oldest_session_of_a_token_gives_way_to_one_too_many_and_nobody_elses_does():
    sessions = Sessions()
    of_admin = sessions.begin("the admin's")
    first, *others = [sessions.begin("a viewer's") for _ in range(MOST_OF_A_TOKEN + 1)]
    assert sessions.token_of(first) is None
    assert all(sessions.token_of(other) for other in others)
    assert sessions.token_of(of_admin) == "the admin's"


def test_the_oldest_of_all_sessions_gives_way_to_one_too_many_of_all():
    sessions = Sessions()
    first, *others = [sessions.begin(str(k)) for k in range(MOST_SESSIONS + 1)]
    assert sessions.token_of(first) is None
    assert all(sessions.token_of(other) for other in others)
    assert len(sessions) == MOST_SESSIONS


def test_a_service_without_a_token_asks_nobody_to_log_in(shared_client):
    assert shared_client.get("/api/login").json() == {**STRANGER, "needed": False, "role": "admin"}
    assert shared_client.post("/api/login", json={"token": "whatever"}).json()["needed"] is False
    assert shared_client.get("/api/rigs", headers={"Authorization": "Bearer whatever"}).status_code == 200


RIG = """
[[rig]]
name = "bench-1"
stage = {driver = "smc100", port = "/dev/there-is-none"}
imu = {driver = "calrig", port = "/dev/there-is-none-either"}
"""
CALRIG = (sys.executable, "-m", "calrig")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the command is run: a configuration, a store, and no token."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALRIG_DB", str(tmp_path / "calrig.db"))
    monkeypatch.delenv("CALRIG_TOKEN", raising=False)
    (tmp_path / "calrig.toml").write_text(RIG)
    return tmp_path


@pytest.fixture
def serve(folder):
    """Starts the service; returns its first line and a client by way of loopback."""
    processes = []

    def serve(*arguments):
        process = subprocess.Popen(
            [*CALRIG, "serve", "--port", "0", *arguments], stdout=subprocess.PIPE, text=True
        )
        processes.append(process)
        line = process.stdout.readline()
        port = re.search(r":(\d+), store", line)[1]
        return line, f"http://127.0.0.1:{port}"

    yield serve
    for process in processes:
        process.terminate()
        process.wait(60)
        process.stdout.close()


def test_without_a_token_others_are_not_let_in_and_the_command_says_how_to_make_one(folder):
    line = reason("serve", "--port", "0", "--host", "0.0.0.0", status=2)
    assert "set CALRIG_TOKEN" in line
    assert "token_urlsafe" in line
    assert not (folder / "calrig.db").exists()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5"])
def test_an_address_that_others_reach_needs_a_token(folder, host):
    with pytest.raises(AccessError, match="CALRIG_TOKEN"):
        access_here(host, host, Settings())


@pytest.mark.parametrize(
    ("token", "host"), [("", "127.0.0.1"), ("short", "0.0.0.0"), ("x" * 15 + " x", "::1")]
)
def test_a_token_that_could_be_guessed_or_typed_wrong_is_refused_everywhere(folder, monkeypatch, token, host):
    monkeypatch.setenv("CALRIG_TOKEN", token)
    with pytest.raises(AccessError, match="16 ASCII characters"):
        access_here(host, host, Settings())


def test_names_for_people_elsewhere_need_a_token_too(folder):
    with pytest.raises(AccessError, match="`hosts`"):
        access_here("127.0.0.1", "127.0.0.1", Settings(hosts=("calrig.lab.example",)))


def test_on_all_addresses_it_says_that_it_asks_for_the_token_and_is_reached_by_each_of_them(
    serve, monkeypatch
):
    monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
    line, url = serve("--host", "0.0.0.0")
    assert "asks for the token of CALRIG_TOKEN" in line
    assert TOKEN not in line
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert httpx.get(f"{url}/api/rigs").status_code == 401
    names = ["127.0.0.1:1", "localhost", "0.0.0.0", socket.gethostname(), f"{socket.gethostname()}.local"]
    for name in names:
        assert httpx.get(f"{url}/api/rigs", headers={**bearer, "Host": name}).status_code == 200, name
    elsewhere = httpx.get(f"{url}/api/rigs", headers={**bearer, "Host": "evil.example"})
    assert elsewhere.status_code == 403


def test_on_loopback_a_token_that_is_set_is_asked_for_and_the_name_of_a_proxy_is_known(
    serve, folder, monkeypatch
):
    monkeypatch.setenv("CALRIG_TOKEN", TOKEN)
    (folder / "calrig.toml").write_text('hosts = ["calrig.lab.example"]\n' + RIG)
    line, url = serve()
    assert "asks for the token of CALRIG_TOKEN" in line
    assert httpx.get(f"{url}/api/runs").status_code == 401
    by_proxy = {
        "Authorization": f"Bearer {TOKEN}",
        "Host": "calrig.lab.example",
        "Origin": "https://calrig.lab.example",
        "X-Forwarded-Proto": "https",
    }
    assert httpx.post(f"{url}/api/logout", headers=by_proxy).status_code == 200
