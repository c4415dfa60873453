"""The token: what is open without it, how programs and people show it, and what a wrong one gets."""

from __future__ import annotations

import asyncio
import json
import re

import httpx
import pytest
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from support import NO_TLS, run_async, running_service, serving

from calrig.api.access import Access
from calrig.api.app import DOCUMENT
from calrig.api.authentication import MOST_SESSIONS, SESSION_S, WAITING_EACH, Authentication, Sessions
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


def test_the_oldest_session_gives_way_to_one_too_many():
    sessions = Sessions()
    first, *others = [sessions.begin(str(k)) for k in range(MOST_SESSIONS + 1)]
    assert sessions.token_of(first) is None
    assert all(sessions.token_of(other) for other in others)
    assert len(sessions) == MOST_SESSIONS


def test_a_service_without_a_token_asks_nobody_to_log_in(shared_client):
    assert shared_client.get("/api/login").json() == {**STRANGER, "needed": False, "role": "admin"}
    assert shared_client.post("/api/login", json={"token": "whatever"}).json()["needed"] is False
    assert shared_client.get("/api/rigs", headers={"Authorization": "Bearer whatever"}).status_code == 200
