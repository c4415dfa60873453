"""Strangers' connections give way to whoever comes; who has shown the token keeps its place."""

from __future__ import annotations

import json
from contextlib import ExitStack, closing
from http.client import HTTPConnection, HTTPResponse

import pytest
from raw_http import connected, everything, has_hung_up, head
from support import LONG, running_service, serving, wait_for

from calrig.api import body_limits, connections, events, server
from calrig.api.access import Access, network_of

TOKEN = "the-benches-of-building-4"
BEARER = f"Authorization: Bearer {TOKEN}"
CROWD = 40


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    return tmp_path_factory.mktemp("strangers")


@pytest.fixture(scope="module")
def guarded(rig, stores):
    """A client, with the token, of a service that has few places and asks for it."""
    with ExitStack() as stack:
        # On a busy machine a test lasts longer than the five seconds after which idle connections are closed.
        stack.enter_context(pytest.MonkeyPatch.context()).setattr(server, "KEEP_ALIVE_S", 600)
        service = stack.enter_context(running_service(stores / "guarded.db", rig))
        client = stack.enter_context(serving(service, access=Access(TOKEN)))
        client.headers["Authorization"] = f"Bearer {TOKEN}"
        yield client


@pytest.fixture(autouse=True)
def few_places(monkeypatch):
    monkeypatch.setattr(connections, "MOST", 16)
    monkeypatch.setattr(connections, "FOR_NEWCOMERS", 4)
    monkeypatch.setattr(connections, "HEAD_S", 60.0)
    monkeypatch.setattr(body_limits, "GRACE_S", 60.0)


def ask(client, one, *more):
    """The status of a GET's answer; the connection stays open."""
    one.sendall(head(client, "GET /api/login HTTP/1.1", *more))
    answer = HTTPResponse(one)
    answer.begin()
    answer.read()
    return answer.status


def anew(client, method, path):
    """Status and headers of the answer to a request that comes by a connection of its own, with the token."""
    host, port = client.base_url.host, client.base_url.port
    with closing(HTTPConnection(host, port, timeout=60)) as connection:
        connection.request(method, path, headers={"Authorization": f"Bearer {TOKEN}"})
        answer = connection.getresponse()
        return answer.status, answer.headers


def slow(client, one, place=0):
    """Begins a body and does not end it."""
    path = ("/api/login", "/api/runs")[place % 2]
    kind = "Content-Type: application/json"
    one.sendall(head(client, f"POST {path} HTTP/1.1", kind, "Content-Length: 900") + b"{")


def test_slow_strangers_keep_nobody_out_who_has_the_token(guarded):
    with ExitStack() as stack:
        for place in range(CROWD):
            slow(guarded, stack.enter_context(connected(guarded)), place)
            if place % 2:
                assert anew(guarded, "POST", "/api/rigs/bench-1/stop")[0] == 200


def test_who_has_shown_the_token_keeps_its_place_and_strangers_lose_theirs_oldest_first(guarded):
    with ExitStack() as stack:
        known, stranger = (stack.enter_context(connected(guarded)) for _ in range(2))
        assert ask(guarded, known, BEARER) == 200
        assert ask(guarded, stranger) == 200
        for _ in range(CROWD):
            slow(guarded, stack.enter_context(connected(guarded)))
        assert ask(guarded, known, BEARER) == 200
        assert wait_for(lambda: has_hung_up(stranger), "end of the stranger's connection")


def test_a_connection_is_judged_by_its_last_request_since_a_proxy_mixes_those_of_many(guarded):
    with ExitStack() as stack:
        mixed = stack.enter_context(connected(guarded))
        assert ask(guarded, mixed, BEARER) == 200
        assert ask(guarded, mixed) == 200
        for _ in range(CROWD):
            slow(guarded, stack.enter_context(connected(guarded)))
        assert wait_for(lambda: has_hung_up(mixed), "end of the connection")


def test_where_all_places_are_kept_a_new_connection_takes_that_of_who_was_idle_longest(guarded):
    with ExitStack() as stack:
        known = []
        for _ in range(20):
            known.append(stack.enter_context(connected(guarded)))
            assert ask(guarded, known[-1], BEARER) == 200
        assert wait_for(lambda: has_hung_up(known[0]), "end of the first one")
        assert ask(guarded, known[-1], BEARER) == 200


def test_one_address_takes_strangers_places_from_its_own_alone(guarded, monkeypatch):
    monkeypatch.setattr(connections, "network_of", lambda address: address)  # as if not of this machine
    monkeypatch.setattr(connections, "STRANGERS_EACH", 3)
    with ExitStack() as stack:
        few = [stack.enter_context(connected(guarded, source="127.0.0.2")) for _ in range(3)]
        crowd = [stack.enter_context(connected(guarded, source="127.0.0.3")) for _ in range(12)]
        for one in (*few, *crowd):
            slow(guarded, one)
        assert wait_for(lambda: has_hung_up(crowd[0]), "end of the crowd's first one")
        assert not any(has_hung_up(one) for one in (*few, crowd[-1]))


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.168.1.9", "192.168.1.9"),
        ("::ffff:192.168.1.9", "192.168.1.9"),
        ("2001:db8::1:2", "2001:db8::/64"),
        ("127.0.0.1", None),
        ("::1", None),
    ],
)
def test_a_client_has_an_ipv4_address_or_a_subnet_of_ipv6_and_nobody_has_loopback(address, network):
    assert network_of(address) == network


def test_a_refused_client_has_its_answer_whole_and_its_connection_is_closed(guarded):
    """Of a body that was still on its way, the rest is dropped: a reset would take the answer away."""
    with connected(guarded) as one:
        kind = "Content-Type: application/json"
        one.sendall(head(guarded, "POST /api/runs HTTP/1.1", kind, "Content-Length: 3000000"))
        for _ in range(30):
            one.sendall(b" " * 50_000)
        answered, body = everything(one).split(b"\r\n\r\n")
        assert answered.startswith(b"HTTP/1.1 401 ")
        assert b"connection: close" in answered.lower()
        assert "has not shown a token" in json.loads(body)["detail"]


def test_a_login_of_more_than_a_few_kilobytes_is_413(guarded):
    answer = guarded.post("/api/login", json={"token": "x" * 20_000})
    assert answer.status_code == 413
    assert "0.01 MB" in answer.json()["detail"]


def test_without_a_token_the_slow_give_way_and_a_stream_of_events_goes_on(rig, stores, monkeypatch):
    monkeypatch.setattr(events, "MOST", 1)
    with (
        running_service(stores / "open.db", rig) as service,
        serving(service) as client,
        ExitStack() as stack,
    ):
        run_id = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()["id"]
        stream = stack.enter_context(connected(client))
        stream.sendall(head(client, f"GET /api/runs/{run_id}/events HTTP/1.1", "Connection: close"))
        assert stream.recv(65536).startswith(b"HTTP/1.1 200 ")
        for place in range(CROWD):
            slow(client, stack.enter_context(connected(client)), place)
            if place % 8 == 0:
                assert anew(client, "GET", "/api/rigs")[0] == 200
        status, headers = anew(client, "GET", f"/api/runs/{run_id}/events")
        assert (status, headers["Retry-After"]) == (503, "5")
        assert anew(client, "POST", f"/api/runs/{run_id}/abort")[0] == 200
        assert b'"aborted"' in everything(stream)
