"""Clients that dawdle: each is answered or cut off in a bounded time, and nobody else waits for them."""

from __future__ import annotations

import json
import socket
import threading
from contextlib import ExitStack

import httpx
import pytest
from raw_http import connected, everything, has_hung_up, head
from support import LONG, running_service, serving, wait_for

from calrig.api import body_limits, connections

CROWD = 200
PATIENCE_S = 0.4


@pytest.fixture(scope="module")
def hurried(rig, tmp_path_factory):
    """A client of a service whose patience with a request that it has begun to hear is short."""
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        for name in ("REST_S", "UNREAD_S"):
            patch.setattr(connections, name, PATIENCE_S)
        patch.setattr(body_limits, "GRACE_S", PATIENCE_S)
        path = tmp_path_factory.mktemp("hurried") / "calrig.db"
        yield stack.enter_context(serving(stack.enter_context(running_service(path, rig))))


def dribble(one, text):
    """Sends a byte at a time until the service answers or hangs up."""
    for byte in text:
        try:
            one.sendall(bytes([byte]))
        except OSError:
            return
        one.settimeout(0.02)
        try:
            if one.recv(1, socket.MSG_PEEK) is not None:
                return
        except TimeoutError:
            continue
        finally:
            one.settimeout(60)


def test_a_head_that_comes_a_byte_at_a_time_is_408(hurried, monkeypatch):
    monkeypatch.setattr(connections, "HEAD_S", PATIENCE_S)
    with connected(hurried) as one:
        dribble(one, b"GET /api/health HTTP/1.1\r\nX-Slow: " + b"x" * 10_000)
        answer = everything(one)
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert "did not come within" in json.loads(answer.split(b"\r\n\r\n")[1])["detail"]


def test_a_connection_that_asks_for_nothing_is_closed(hurried, monkeypatch):
    monkeypatch.setattr(connections, "HEAD_S", PATIENCE_S)
    with connected(hurried) as one:
        assert everything(one) == b""


@pytest.mark.parametrize("path", ["/api/runs", "/api/imports"])
def test_a_body_that_comes_a_byte_at_a_time_is_408(hurried, path):
    kind = "application/json" if path == "/api/runs" else "multipart/form-data; boundary=x"
    with connected(hurried) as one:
        one.sendall(head(hurried, f"POST {path} HTTP/1.1", f"Content-Type: {kind}", "Content-Length: 90000"))
        dribble(one, b"--x\r\n" + b"x" * 10_000)
        answer = everything(one)
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"came too slowly" in answer


def test_the_rest_of_a_refused_body_is_not_waited_for(hurried):
    with connected(hurried) as one:
        one.sendall(head(hurried, "POST /api/runs HTTP/1.1", "Content-Length: 2000000000"))
        assert one.recv(65536).startswith(b"HTTP/1.1 413 ")
        dribble(one, b"x" * 10_000)
        everything(one)


def test_a_client_that_does_not_read_its_answers_is_cut_off(hurried):
    with connected(hurried, small_window=True) as one:
        one.sendall(head(hurried, "GET /api/openapi.json HTTP/1.1") * 5)
        assert wait_for(lambda: has_hung_up(one), "end of the connection")


def test_clients_that_together_leave_too_much_unread_are_cut_off_before_their_time(hurried, monkeypatch):
    monkeypatch.setattr(connections, "UNREAD_S", 60.0)
    monkeypatch.setattr(connections, "UNREAD_BYTES", 500_000)
    with ExitStack() as stack:
        crowd = [stack.enter_context(connected(hurried, small_window=True)) for _ in range(20)]
        for one in crowd:
            one.sendall(head(hurried, "GET /api/openapi.json HTTP/1.1") * 5)
        assert wait_for(lambda: has_hung_up(crowd[0]), "end of the first one")
        assert not has_hung_up(crowd[-1])


@pytest.mark.parametrize("crowd_of", [12, pytest.param(CROWD, marks=pytest.mark.memory)])
def test_a_crowd_who_dawdle_keep_nobody_waiting(hurried, monkeypatch, crowd_of):
    """Heads that do not end, bodies that do not come, event streams and files that nobody reads.

    The service is patient with them for longer than the client that asks meanwhile is with the service.
    """
    for module, name in ((connections, "HEAD_S"), (connections, "UNREAD_S"), (body_limits, "GRACE_S")):
        monkeypatch.setattr(module, name, 100.0)
    before = threading.active_count()
    began = hurried.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    asked = (
        b"GET /api/health HTTP/1.1\r\nX: ",
        head(
            hurried,
            "POST /api/imports HTTP/1.1",
            "Content-Type: multipart/form-data; boundary=x",
            "Content-Length: 9000",
        ),
        head(hurried, f"GET /api/runs/{began['id']}/events HTTP/1.1"),
        head(hurried, "GET /api/openapi.json HTTP/1.1") * 5,
    )
    with ExitStack() as stack:
        crowd = [stack.enter_context(connected(hurried, small_window=True)) for _ in range(crowd_of)]
        for place, one in enumerate(crowd):
            one.sendall(asked[place % len(asked)])
        for _ in range(20):
            assert hurried.get("/api/runs?limit=1").status_code == 200
        small = {"file": ("p.csv", b"target_deg,reading_deg\n0,0.1\n10,10.1\n")}
        assert hurried.post("/api/imports", files=small, data={"unit": "B"}).status_code == 201
        assert threading.active_count() < before + 60  # 40 for requests, the run's and its rig's
        assert hurried.post(f"/api/runs/{began['id']}/abort").status_code == 200


def test_beyond_the_most_connections_one_that_asks_for_nothing_makes_room(hurried, monkeypatch):
    monkeypatch.setattr(connections, "MOST", 20)
    monkeypatch.setattr(connections, "FOR_NEWCOMERS", 5)
    monkeypatch.setattr(connections, "HEAD_S", 60.0)
    with ExitStack() as stack:
        idle = [stack.enter_context(connected(hurried)) for _ in range(60)]
        # Not by the shared client: its connection, idle since the last test, may be the one to make room.
        assert httpx.get(hurried.base_url.join("/api/health"), timeout=60).status_code == 200
        assert wait_for(lambda: everything(idle[0]) == b"", "end of the first one")


def test_the_upload_that_comes_most_slowly_makes_room_for_another(hurried, monkeypatch):
    monkeypatch.setattr(body_limits, "GRACE_S", 60.0)
    monkeypatch.setattr(body_limits, "MOST_UPLOADS", 4)
    begun = head(
        hurried,
        "POST /api/imports HTTP/1.1",
        "Content-Type: multipart/form-data; boundary=x",
        "Content-Length: 900000",
    )
    with ExitStack() as stack:
        part = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n'
        slow = [stack.enter_context(connected(hurried)) for _ in range(4)]
        for place, one in enumerate(slow):
            one.sendall(begun + part + b"x" * 10_000 * place)
        small = {"file": ("p.csv", b"target_deg,reading_deg\n0,0.1\n10,10.1\n")}
        for _ in range(4):
            assert hurried.post("/api/imports", files=small, data={"unit": "B"}).status_code == 201
        assert slow[0].recv(65536).startswith(b"HTTP/1.1 408 ")
        assert not has_hung_up(slow[3])
