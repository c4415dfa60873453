"""Events over a line that is cut again and again: none is lost, none comes twice."""

from __future__ import annotations

import random
import socket
import threading
from contextlib import closing, contextmanager

import pytest
from support import QUICK, running_service, serving

import calrig
from calrig.client import Refused
from calrig.client import run as events
from calrig.client.run import parsed


@contextmanager
def cut_line(url: str, pieces: list[int]):
    """A relay to a service that hangs up after so many bytes of each answer, then passes on all of them."""
    host, _, port = url.removeprefix("http://").partition(":")

    def carry(near: socket.socket, most: int | None) -> None:
        with closing(near), closing(socket.create_connection((host, int(port)))) as far:
            far.sendall(near.recv(65536))  # of a GET, all there is
            while (most is None or most > 0) and (piece := far.recv(65536)):
                piece = piece[:most]
                near.sendall(piece)
                most = None if most is None else most - len(piece)

    def accept() -> None:
        while True:
            try:
                near, _ = listener.accept()
            except OSError:
                return
            most = pieces.pop(0) if pieces else None
            threading.Thread(target=carry, args=(near, most), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=accept, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            listener.shutdown(socket.SHUT_RDWR)


@pytest.fixture(scope="module")
def service(rig, tmp_path_factory):
    path = tmp_path_factory.mktemp("client") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        yield calrig.Client(str(client.base_url))


def test_a_line_that_is_cut_anywhere_loses_and_doubles_nothing(service, monkeypatch):
    monkeypatch.setattr(events, "AGAIN_S", 0.01)
    run = service.calibrate("AS-0042", plan=QUICK)
    whole = list(run.events())
    cuts = random.Random(1)
    pieces = [0, 20, *(cuts.randrange(250, 1500) for _ in range(12))]
    with cut_line(service.server, pieces) as url:
        followed = calrig.Client(url)
        path = f"/api/runs/{run.id}"
        away = []
        assert list(events.run_events(followed, run.id, away=away.append)) == whole
        assert "does not answer" in str(away[0])
        assert pieces == [], "every cut was made"
        assert followed.get(path)["status"] == "completed"


def test_a_run_that_is_not_there_is_said_at_once(service):
    with pytest.raises(Refused, match="there is no run 99"):
        next(events.run_events(service, "99"))


def test_fields_of_events_are_read_as_the_standard_has_them():
    lines = b": a comment\r\n\r\nid: 7\r\nevent:pose\ndata: {\ndata:  1}\nretry\n\ndata: not whole"
    assert list(parsed(lines.splitlines(keepends=True))) == [
        {"id": "7", "event": "pose", "data": "{\n 1}", "retry": ""}
    ]
