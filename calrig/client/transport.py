"""HTTP to a service by httpx, with the token of CALRIG_TOKEN: JSON, text, files, streams of lines."""

import json
import os
import ssl
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import IO, Any
from urllib.parse import urlsplit

import httpx

from calrig.client.errors import INVALID, Invalid, Refused, Unreachable
from calrig.errors import InputError, printable, readable


def checked(server: str) -> str:
    """The address of a service, without a slash at its end.

    Raises:
        InputError: it is none, or has a secret in it.
    """
    try:
        named = urlsplit(server)
        is_one = named.scheme in {"http", "https"} and bool(httpx.URL(server).host) and named.port != 0
    except (ValueError, httpx.InvalidURL):  # no such port, or half an IPv6 address
        is_one = False
    if is_one and named.username is not None:
        raise InputError(
            f"{named.scheme}://…@{named.netloc.rpartition('@')[2]}: a name and a password are not shown to "
            "calrig: name the address without them, the token goes into CALRIG_TOKEN"
        )
    if not is_one or named.query or named.fragment or any(c.isspace() for c in server):
        raise InputError(f"{server}: is no address such as http://lab-pc:8000")
    return server.rstrip("/")


def is_loopback(host: str) -> bool:
    """Whether a host is this machine, whatever names are resolved to."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def why_unreachable(failure: Exception) -> str:
    """Why nobody answers as calrig does, and what to do where that is known."""
    below = getattr(failure.__cause__, "args", ())  # httpcore's error, made of the system's
    error = next((one for one in below if isinstance(one, Exception)), failure)
    if isinstance(error, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not believed ({error.verify_message}): name the file of your own authority "
            "by SSL_CERT_FILE, `calrig agent enroll` by --ca, in Python by Client(…, certificates=…)"
        )
    if isinstance(error, ssl.SSLError):
        return f"does not speak TLS ({error.reason}): is its address http://…?"
    if isinstance(error, ConnectionRefusedError):
        return "does not answer: nothing listens there; is `calrig serve` running?"
    return f"does not answer ({getattr(error, 'strerror', None) or error})"


GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)
"""Set by `AsyncClient` where its caller was cancelled."""


class Cancelled(BaseException):
    """Ends the thread's work as Ctrl-C would; nobody hears of it."""


def nap(seconds: float = 0.0) -> None:
    """Waits for a while; not at all, it looks whether to go on.

    Raises:
        Cancelled: nobody wants the outcome any more.
    """
    given_up = GIVEN_UP.get() or threading.Event()
    if given_up.wait(seconds):
        raise Cancelled


PATIENCE_S = 30.0
"""Without a byte; a stream that has nothing to tell sends a comment every 12 s."""
MOST_REDIRECTIONS = 10
HEADERS = {"Connection": "close", "Accept-Encoding": "identity"}
"""A connection for each call, so that no call finds its connection closed by the service."""


class Transport:
    """The service at an address such as `http://lab-pc:8000`.

    Attributes:
        server: the address.
        said_by: what its words begin with: who says them, where that is not this process itself.
    """

    def __init__(
        self,
        server: str,
        certificates: ssl.SSLContext | None = None,
        *,
        token: str | None = None,
        follows: bool = False,
        through: httpx.BaseTransport | None = None,
    ) -> None:
        """Nothing is sent yet.

        Args:
            server: `http` or `https`, with whatever path a proxy has it under.
            certificates: whose are believed; without it those that this machine trusts.
            token: shown to this address alone; without it that of CALRIG_TOKEN, where it is set.
            follows: whether it goes where a redirection leads, without the token.
            through: what carries requests, without a token, in place of the network.

        Raises:
            InputError: it is no such address, or a proxy of the environment cannot be used.
        """
        self.server = checked(server)
        self.said_by = f"{self.server}: " if through is None else ""
        self._given, self._follows = token, follows
        here = httpx.URL(server)
        if certificates is None and (here.scheme == "https" or follows):
            certificates = ssl.create_default_context()
        try:
            self._http = httpx.Client(
                headers=HEADERS,
                verify=certificates or ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT),  # which believes nobody
                timeout=PATIENCE_S,
                limits=httpx.Limits(max_connections=None, max_keepalive_connections=0),
                trust_env=not is_loopback(here.host),  # no proxy hears what stays on this machine
                transport=through,
            )
        except (ImportError, ValueError, httpx.InvalidURL) as error:
            raise InputError(f"the proxy that the environment names cannot be used: {error}") from error

    def get(self, path: str) -> Any:
        """The JSON at a path.

        Raises:
            Invalid: what was asked for is wrong.
            Refused: the service refuses otherwise.
            Unreachable: it does not answer.
        """
        return self._json(self._request("GET", path))

    def text(self, path: str) -> str:
        """The text at a path; errors as of `get`."""
        return b"".join(self.pieces(path)).decode()

    def pieces(self, path: str) -> Iterator[bytes]:
        """What is at a path, as it comes; errors as of `get`, also where it ends too soon."""
        with self._answer(self._request("GET", path)) as answer:
            for piece in answer.iter_bytes():
                nap()
                yield piece

    def post(self, path: str, body: Mapping[str, Any]) -> Any:
        """The answer to a body; errors as of `get`."""
        return self._json(self._request("POST", path, json=body))

    def delete(self, path: str) -> Any:
        """The answer to the end of what is at a path; errors as of `get`."""
        return self._json(self._request("DELETE", path))

    def upload(self, path: str, file: Path, fields: Mapping[str, str], told: Callable[[float], None]) -> Any:
        """The answer to a form with a file, which is read as it is sent: 100 MB take no memory.

        Args:
            path: where the form goes.
            file: sent under its name as the field `file`.
            fields: the others.
            told: the share that is sent, 0 to 1, again and again.

        Raises:
            InputError: the file cannot be read; others as of `get`.
        """
        name = os.fsencode(file.name).decode("utf-8", "backslashreplace")
        data = {key: value.encode("utf-8", "surrogateescape") for key, value in fields.items()}
        with _opened(file) as opened:
            sent = _Sent(file, opened, told)
            files = {"file": (name, sent, "text/csv")}
            return self._json(self._request("POST", path, data=data, files=files))

    @contextmanager
    def lines(self, path: str, headers: Mapping[str, str]) -> Iterator[Iterator[bytes]]:
        """The lines of an answer as they come; errors as of `get`, also in their midst."""
        with self._answer(self._request("GET", path, headers=headers)) as answer:
            yield self._lines(answer)

    def _lines(self, answer: httpx.Response) -> Iterator[bytes]:
        """Lines end with a line feed only: those of httpx end within text as well, by U+2028."""
        rest = b""
        try:
            for piece in answer.iter_bytes():
                *whole, rest = (rest + piece).split(b"\n")
                yield from whole
        except httpx.HTTPError as error:
            raise self._unreachable(error) from error

    def _request(self, method: str, path: str, **content: Any) -> httpx.Request:
        request = self._http.build_request(method, self.server + path, **content)
        token = self._token()
        if token:
            if not (token.isascii() and token.isprintable()):
                raise InputError("CALRIG_TOKEN: a token is printable ASCII")
            request.headers["Authorization"] = f"Bearer {token}"
        return request

    def _token(self) -> str | None:
        return (self._given or os.environ.get("CALRIG_TOKEN")) if self.said_by else None

    def _json(self, request: httpx.Request) -> Any:
        with self._answer(request) as answer:
            try:
                return json.loads(answer.read())
            except ValueError as error:
                raise Unreachable(f"{self.server}: answers, and not as calrig does") from error

    @contextmanager
    def _answer(self, request: httpx.Request) -> Iterator[httpx.Response]:
        try:
            answer = self._http.send(request, stream=True)
            for _ in range(MOST_REDIRECTIONS if self._follows else 0):
                if answer.next_request is None:
                    break
                answer.close()
                answer.next_request.headers.pop("Authorization", None)
                answer = self._http.send(answer.next_request, stream=True)
            try:
                if not answer.is_success:
                    kind = Invalid if answer.status_code == INVALID else Refused
                    raise kind(f"{self.said_by}{self._detail(answer)}", answer.status_code)
                yield answer
            finally:
                answer.close()
        except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
            raise self._unreachable(error) from error

    def _unreachable(self, error: Exception) -> Unreachable:
        return Unreachable(f"{self.said_by}{why_unreachable(error)}")

    def _detail(self, answer: httpx.Response) -> str:
        to = answer.headers.get("Location")
        if to is not None:
            return f"sends on to {printable(to)}: name that address, if calrig is there"
        try:
            said = str(json.loads(answer.read())["detail"])
        except (ValueError, KeyError, TypeError, httpx.HTTPError):
            said = f"answers {answer.status_code} {answer.reason_phrase}"
        if answer.status_code != HTTPStatus.UNAUTHORIZED:
            return said
        return f"{said}; calrig shows that of CALRIG_TOKEN" + ("" if self._token() else ", which is not set")


def part(answer: Any, name: str) -> Any:
    """A field of an answer.

    Raises:
        Unreachable: it has none, so the answer is not calrig's.
    """
    try:
        return answer[name]
    except (KeyError, TypeError) as error:
        raise Unreachable(f"the service answers, and not as calrig does (no {name!r})") from error


@contextmanager
def _opened(file: Path) -> Iterator[IO[bytes]]:
    """The file, its length known: of a pipe a copy.

    Raises:
        InputError: it cannot be read.
    """
    with readable(file):
        opened: IO[bytes] = file.open("rb")
        if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
            with opened as piped:
                opened = TemporaryFile()  # noqa: SIM115 (closed below)
                copyfileobj(piped, opened)
                opened.flush()
    with opened:
        yield opened


class _Sent:
    """A file that httpx reads as it sends it; it has the length that it began with."""

    def __init__(self, file: Path, opened: IO[bytes], told: Callable[[float], None]) -> None:
        self._name, self._opened, self._told = file, opened, told
        self._n_bytes = self._left = os.fstat(opened.fileno()).st_size
        self.fileno, self.tell = opened.fileno, opened.tell

    def seek(self, to: int, whence: int = os.SEEK_SET) -> int:
        """As of a file; httpx goes to the beginning alone."""
        self._left = self._n_bytes
        return self._opened.seek(to, whence)

    def read(self, n_bytes: int) -> bytes:
        """The next bytes.

        Raises:
            Cancelled: nobody wants the outcome any more.
            InputError: the file has become shorter.
        """
        nap()
        piece = self._opened.read(min(n_bytes, self._left))
        if self._left and not piece:
            raise InputError(f"{self._name}: has become shorter while it was sent")
        self._left -= len(piece)
        if piece:
            self._told(1.0 - self._left / self._n_bytes)
        return piece
