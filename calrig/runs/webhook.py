"""Report each run's end to another program: signed JSON, retried for two days, without delaying a run.

The signature is `t=SECONDS,v1=HEX`. HEX is the HMAC-SHA256 (RFC 2104) of `SECONDS.BODY` with the secret;
SECONDS is the Unix time of the try. Redirects are not followed: only the configured address is used.
"""

import hashlib
import hmac
import http.client
import json
import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from http import HTTPStatus
from urllib.parse import urlsplit

from prometheus_client import Counter, Gauge

import calrig
from calrig.model.run import TERMINAL
from calrig.runs.services import Service
from calrig.settings import SettingsError, WebhookSettings
from calrig.store import Run, StoreError
from calrig.store.records import Document

log = logging.getLogger(__name__)

AGAIN_S = (5, 30, 120, 600, 1800, *[3600] * 47)
"""Until the next try, after each that failed: two days in all."""
ANSWERS_S = 10.0
TAKEN = timedelta(seconds=60)
"""How long a delivery is one program's, which may die."""
LOOK_S = 1.0
CLOSE_S = 1.0
"""How long a try under way is waited for at the end: it is made again, and told by `Calrig-Delivery`."""
VERDICT = ("answer", "reliable", "says")
RESULT = ("bias_deg", "scale", "rms_raw_deg", "rms_calibrated_deg", "rms_with_effects_deg", "n_poses")
SIGNATURE = "Calrig-Signature"
SHORTEST_SECRET = 16


class Webhook:
    """A thread that notes ends of runs and delivers them.

    Raises:
        SettingsError: there is no key.
    """

    def __init__(
        self,
        service: Service,
        settings: WebhookSettings,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._store, self._service = service.store, service
        self._url, self._secret = settings.url, secret_of(settings)
        self._now = now
        self._news = threading.Condition()
        self._heard: set[str] = set()
        self._closing = False
        registry = service.meter.registry
        self._failures = Counter(
            "calrig_webhook_failures", "Tries of a webhook that failed.", registry=registry
        )
        waiting = Gauge("calrig_webhook_waiting", "Ends of runs not delivered yet.", registry=registry)
        waiting.set_function(self._waiting)
        self._thread = threading.Thread(target=self._work, name="webhook", daemon=True)

    def start(self) -> None:
        """Begins; what ended before a program died is delivered first."""
        self._service.bus.hear(self._hear)
        self._heard.update(self._store.deliveries.unrecorded_ends())
        self._thread.start()

    def close(self) -> None:
        """Ends it; what is not delivered yet is by the next program."""
        with self._news:
            self._closing = True
            self._news.notify_all()
        self._thread.join(CLOSE_S)

    def _hear(self, run_id: str) -> None:
        with self._news:
            self._heard.add(run_id)  # whether it has ended is looked for once a while: a run says much

    def _waiting(self) -> float:
        try:
            return self._store.deliveries.count_waiting()
        except StoreError:
            return float("nan")

    def _work(self) -> None:
        """Notes and delivers until it is closed; the store's trouble is waited out."""
        told = ""
        while not self._closing:
            wait_s = LOOK_S
            try:
                self.note()
                wait_s = min(LOOK_S, self.deliver())
                told = ""
            except StoreError as error:
                if told != str(error) and not self._closing:
                    log.error("ends of runs are not told of now: %s", error)
                told = str(error)
            with self._news:
                if not self._closing:
                    self._news.wait(wait_s)

    def note(self) -> None:
        """Takes in which of the runs that said something have ended."""
        with self._news:
            heard, self._heard = self._heard, set()
        try:
            for run_id in sorted(heard):
                run = self._store.runs.get(run_id)
                if run is not None and run.status in TERMINAL:
                    self._store.deliveries.record_end(run_id, self._now())
        except StoreError:
            with self._news:
                self._heard |= heard
            raise

    def deliver(self) -> float:
        """Makes the delivery that is due; seconds until it is worth another look."""
        delivery, now = self._store.deliveries.next(), self._now()
        if delivery is None:
            return LOOK_S
        if delivery.due_at > now:
            return min(LOOK_S, (delivery.due_at - now).total_seconds())
        if not self._store.deliveries.claim(delivery, now + TAKEN):
            return 0.0
        run = self._store.runs.get(delivery.run_id)
        error = None if run is None else self._told(run)
        again_at = None
        if error is not None:
            self._failures.inc()
            if delivery.tries < len(AGAIN_S):
                again_at = self._now() + timedelta(seconds=AGAIN_S[delivery.tries])
            word = "given up" if again_at is None else f"tried again at {again_at:%Y-%m-%d %H:%M:%S} UTC"
            log.warning("the end of run %s could not be told (%s): %s", delivery.run_id, error, word)
        self._store.deliveries.settle(delivery, error, again_at)
        return 0.0

    def _told(self, run: Run) -> str | None:
        """Sends it; why that failed, or None."""
        body = json.dumps(document(run), separators=(",", ":")).encode()
        sent_s = str(int(self._now().timestamp()))
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"calrig/{calrig.__version__}",
            "Calrig-Delivery": run.id,
            SIGNATURE: f"t={sent_s},v1={signature(self._secret, sent_s, body)}",
        }
        parts = urlsplit(self._url)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        path = f"{parts.path or '/'}{'?' + parts.query if parts.query else ''}"
        try:
            with closing(kind(parts.hostname or "", parts.port, timeout=ANSWERS_S)) as connection:
                connection.connect()
                with _for_at_most(ANSWERS_S, connection.sock):
                    connection.request("POST", path, body, headers)
                    status = connection.getresponse().status
        except (OSError, http.client.HTTPException, ValueError) as error:
            return f"{type(error).__name__}: {error}"[:300]
        return None if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES else f"it answered {status}"


@contextmanager
def _for_at_most(duration_s: float, connection: socket.socket) -> Iterator[None]:
    """Ends a connection after so long: an answer that comes byte by byte meets every single time-out."""

    def cut() -> None:
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)

    late = threading.Timer(duration_s, cut)
    late.daemon = True
    late.start()
    try:
        yield
    finally:
        late.cancel()


def secret_of(settings: WebhookSettings) -> bytes:
    """The key that is signed with.

    Raises:
        SettingsError: it cannot be read, or is too short to keep anybody out.
    """
    if settings.secret_file is not None:
        kept_in = str(settings.secret_file)
        try:
            key = settings.secret_file.read_bytes().strip()
        except OSError as error:
            raise SettingsError(f"[webhook] {kept_in}: cannot be read ({error.strerror})") from error
    else:
        kept_in = f"the environment's {settings.secret_env}"
        key = os.environ.get(settings.secret_env or "", "").encode().strip()
    if len(key) < SHORTEST_SECRET:
        raise SettingsError(f"[webhook] {kept_in}: has to hold a secret of {SHORTEST_SECRET} bytes or more")
    return key


def signature(secret: bytes, sent_s: str, body: bytes) -> str:
    """HMAC-SHA256 of the time of the try, a dot and the body, in hexadecimal."""
    return hmac.new(secret, sent_s.encode() + b"." + body, hashlib.sha256).hexdigest()


def document(run: Run) -> Document:
    """What is told of a run that has ended."""
    verdict, result = run.verdict, run.result
    return {
        "event": "run_ended",
        "run_id": run.id,
        "unit": run.unit,
        "rig": run.rig,
        "kind": run.kind,
        "status": run.status,
        "error": run.error,
        "operator": run.operator,
        "verdict": None if verdict is None else {name: verdict.to_dict()[name] for name in VERDICT},
        "result": None if result is None else result.model_dump(mode="json", include=set(RESULT)),
        "finished_at": None if run.finished_at is None else run.finished_at.isoformat(),
    }
