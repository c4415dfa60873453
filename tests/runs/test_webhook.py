"""Another program hears of each run's end: signed, again and again until it answers, also after a restart."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from postgresql_server import store_at
from support import at_work, wait_for

from calrig.runs.service import RunService
from calrig.runs.webhook import Webhook, secret_of
from calrig.settings import SettingsError, WebhookSettings
from calrig.store import Store

SECRET = b"a-secret-of-the-labs-own"


class Listener(ThreadingHTTPServer):
    """A program that is told of ends, and answers what it is bidden."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answering)
        self.heard: list[tuple[dict[str, str], bytes]] = []
        self.status = 204

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/calrig?lab=4"


class Answering(BaseHTTPRequestHandler):
    server: Listener

    def do_POST(self) -> None:
        assert self.path == "/calrig?lab=4"
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.heard.append((dict(self.headers), body))
        self.send_response(self.server.status)
        self.send_header("Location", "http://127.0.0.1:1/elsewhere")
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def listener() -> Iterator[Listener]:
    with at_work(Listener()) as server:
        yield server


@pytest.fixture
def own_store(tmp_path: Path) -> Iterator[Store]:
    with Store.open(store_at(tmp_path / "calrig.db"), writer="tests") as opened:
        yield opened


@pytest.fixture
def settings(listener: Listener, tmp_path: Path) -> WebhookSettings:
    (tmp_path / "key").write_bytes(SECRET + b"\n")
    return WebhookSettings(url=listener.url, secret_file=tmp_path / "key")


def ended_run(store: Store, unit: str, status: Any = "failed") -> str:
    run = store.runs.create(unit=unit, rig="bench-1", plan={}, status="running", provenance={})
    store.runs.update(run.id, status=status, error="the stage did not answer")
    return run.id


def test_an_end_is_told_once_signed_and_tried_again_until_it_is_heard(
    own_store: Store, listener: Listener, settings: WebhookSettings
) -> None:
    now = [datetime(2026, 11, 22, 12, 0, tzinfo=UTC)]
    with closing(RunService(own_store, [])) as service:
        hook = Webhook(service, settings, now=lambda: now[0])
        hook._hear(run_id := ended_run(own_store, "W-1"))
        hook._hear(own_store.runs.create(unit="W-2", rig="r", plan={}, status="queued", provenance={}).id)
        hook.note()
        listener.status = 307
        hook.deliver()
        assert 0 < hook.deliver() <= 1.0, "not before it is due"
        waits_s = []
        for _ in range(3):
            now[0] = own_store.deliveries.next().due_at
            before = now[0]
            hook.deliver()
            waits_s.append((own_store.deliveries.next().due_at - before).total_seconds())
        assert waits_s == [30, 120, 600]
        assert service.meter.registry.get_sample_value("calrig_webhook_failures_total") == 4
        assert service.meter.registry.get_sample_value("calrig_webhook_waiting") == 1

    with closing(RunService(own_store, [])) as service:  # after a restart
        listener.status = 204
        again = Webhook(service, settings, now=lambda: now[0])
        now[0] += timedelta(seconds=600)
        again.deliver()
        assert own_store.deliveries.next() is None
        again._hear(run_id)
        again.note()
        again.deliver()
    assert len(listener.heard) == 5, "delivered, it is told of no more"
    headers, body = listener.heard[-1]
    stamp, signed = (part.partition("=")[2] for part in headers["Calrig-Signature"].split(","))
    assert int(stamp) == int(now[0].timestamp())
    assert signed == hmac.new(SECRET, f"{stamp}.".encode() + body, hashlib.sha256).hexdigest()
    told = json.loads(body)
    assert (told["run_id"], told["unit"], told["rig"], told["status"]) == (run_id, "W-1", "bench-1", "failed")
    assert (told["verdict"], told["result"], told["error"]) == (None, None, "the stage did not answer")


def test_a_running_service_tells_and_one_that_died_before_it_noted_an_end_tells_later(
    own_store: Store, listener: Listener, settings: WebhookSettings
) -> None:
    with closing(RunService(own_store, [])) as service, closing(Webhook(service, settings)) as hook:
        hook.start()
        service.bus.wake(ended_run(own_store, "W-1", "completed"))
        wait_for(lambda: listener.heard, "word of the end")
    missed = ended_run(own_store, "W-2", "aborted")
    with closing(RunService(own_store, [])) as service, closing(Webhook(service, settings)) as hook:
        hook.start()
        wait_for(lambda: len(listener.heard) == 2, "word of the other one")
    assert json.loads(listener.heard[1][1])["run_id"] == missed


@pytest.mark.parametrize(
    "given",
    [
        {"url": "ftp://lab/x", "secret_env": "KEY"},
        {"url": "https://user@lab/x", "secret_env": "KEY"},
        {"url": "https://lab/x"},
        {"url": "https://lab/x", "secret_env": "A", "secret_file": "b"},
    ],
)
def test_an_address_without_a_key_or_of_another_kind_is_refused(given: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"webhook|url"):
        WebhookSettings.model_validate(given)


def test_a_key_that_is_too_short_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CALRIG_HOOK", "short")
    with pytest.raises(SettingsError, match="16 bytes"):
        secret_of(WebhookSettings(url="https://lab/x", secret_env="CALRIG_HOOK"))
