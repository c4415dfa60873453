"""The address of a service, looked at before anything is sent there; why nobody answers at it.

Whether anybody still wants what a thread is waiting for: asyncio cannot interrupt it.

HTTP to a running service with the token of CALRIG_TOKEN: JSON, text, files, streams of lines.

A form with a file (RFC 7578), read from the disk as it is sent: 100 MB take no memory.
"""

from __future__ import annotations

import json
import os
import secrets
import ssl
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from contextvars import ContextVar
from http import HTTPStatus
from http.client import HTTPException, HTTPResponse, IncompleteRead
from ipaddress import ip_address
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import IO, Any, Self
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import BaseHandler, HTTPRedirectHandler, HTTPSHandler, ProxyHandler, Request, build_opener

from calrig.client.errors import INVALID, Invalid, Refused, Unreachable
from calrig.errors import InputError, printable


def checked(server: str) -> str:
    """The address of a service, without a slash at its end.

    Raises:
        InputError: it is none, or has a secret in it.
    """
    try:
        named = urlsplit(server)
        is_one = named.scheme in {"http", "https"} and bool(named.hostname) and named.port != 0
    except ValueError:  # no such port, or half an IPv6 address
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


def why_unreachable(error: Exception) -> str:
    """Why nobody answers as calrig does, and what to do where that is known."""
    reason = getattr(error, "reason", None) or error
    if isinstance(reason, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not believed ({reason.verify_message}): name the file of your own authority "
            "by SSL_CERT_FILE, `calrig agent enroll` by --ca, in Python by Client(…, certificates=…)"
        )
    if isinstance(reason, ssl.SSLError):
        return f"does not speak TLS ({reason.reason}): is its address http://…?"
    if isinstance(reason, ConnectionRefusedError):
        return "does not answer: nothing listens there; is `calrig serve` running?"
    return f"does not answer ({getattr(reason, 'strerror', None) or reason})"


GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)
"""Set by `AsyncClient` where its caller was cancelled."""


class Cancelled(BaseException):
    """Ends the thread's work as Ctrl-C would; nobody hears of it."""


def nap(seconds: float = 0.0) -> None:
    """Waits for a while; not at all, it looks whether to go on.

    Raises:
        GivenUp: nobody wants the outcome any more.
    """
    given_up = GIVEN_UP.get() or threading.Event()
    if given_up.wait(seconds):
        raise Cancelled


PATIENCE_S = 30.0
"""Without a byte; a stream that has nothing to tell sends a comment every 12 s."""
PIECE = 1 << 16
"""Bytes read at once."""


class _NoRedirect(HTTPRedirectHandler):
    """Goes nowhere: who answers elsewhere was not asked for, and a POST would arrive there as a GET."""

    def redirect_request(self, *_: Any) -> None:
        """Nothing instead."""


class Transport:
    """The service at an address such as `http://lab-pc:8000`.

    Attributes:
        server: the address.
    """

    def __init__(
        self,
        server: str,
        certificates: ssl.SSLContext | None = None,
        *,
        token: str | None = None,
        follows: bool = False,
    ) -> None:
        """Nothing is sent yet.

        Args:
            server: `http` or `https`, with whatever path a proxy has it under.
            certificates: whose are believed; without it those that this machine trusts.
            token: shown to this address alone; without it that of CALRIG_TOKEN, where it is set.
            follows: whether it goes where a redirection leads, without the token.

        Raises:
            InputError: it is no such address.
        """
        self.server = checked(server)
        self._given = token
        handlers: list[BaseHandler] = [HTTPSHandler(context=certificates)]
        if not follows:
            handlers.append(_NoRedirect())
        if is_loopback(urlsplit(server).hostname or ""):
            handlers.append(ProxyHandler({}))  # nobody else is to see what stays on this machine
        self._open = build_opener(*handlers).open

    def get(self, path: str) -> Any:
        """The JSON at a path.

        Raises:
            Invalid: what was asked for is wrong.
            Refused: the service refuses otherwise.
            Unreachable: it does not answer.
        """
        return self._json(self._request(path))

    def text(self, path: str) -> str:
        """The text at a path; errors as of `get`."""
        return b"".join(self.pieces(path)).decode()

    def pieces(self, path: str) -> Iterator[bytes]:
        """What is at a path, as it comes; errors as of `get`, also where it ends too soon."""
        with self._answer(self._request(path)) as answer:
            while piece := answer.read(PIECE):
                nap()
                yield piece
            if answer.length:  # said by `http.client` of a whole read alone
                raise IncompleteRead(b"", answer.length)

    def post(self, path: str, body: Mapping[str, Any]) -> Any:
        """The answer to a body; errors as of `get`."""
        return self._json(self._request(path, json.dumps(body).encode(), "application/json"))

    def delete(self, path: str) -> Any:
        """The answer to the end of what is at a path; errors as of `get`."""
        return self._json(self._request(path, method="DELETE"))

    def upload(self, path: str, upload: Upload) -> Any:
        """The answer to a form with a file, which is sent piece by piece; errors as of `get`."""
        request = self._request(path, upload, upload.content_type)
        request.add_unredirected_header("Content-Length", str(len(upload)))
        return self._json(request)

    @contextmanager
    def lines(self, path: str, headers: Mapping[str, str]) -> Iterator[Iterator[bytes]]:
        """The lines of an answer as they come; errors as of `get`, also in their midst."""
        request = self._request(path)
        for name, value in headers.items():
            request.add_header(name, value)
        with self._answer(request) as answer:
            yield self._lines(answer)

    def _lines(self, answer: HTTPResponse) -> Iterator[bytes]:
        try:
            yield from answer
        except (HTTPException, OSError) as error:
            raise self._unreachable(error) from error

    def _request(self, path: str, data: Any = None, kind: str = "", method: str | None = None) -> Request:
        headers = {"Content-Type": kind} if kind else {}
        request = Request(self.server + path, data, headers, method=method)  # noqa: S310 (http or https)
        token = self._token()
        if token:
            if not (token.isascii() and token.isprintable()):
                raise InputError("CALRIG_TOKEN: a token is printable ASCII")
            request.add_unredirected_header("Authorization", f"Bearer {token}")
        return request

    def _token(self) -> str | None:
        return self._given or os.environ.get("CALRIG_TOKEN")

    def _json(self, request: Request) -> Any:
        with self._answer(request) as answer:
            try:
                return json.load(answer)
            except ValueError as error:
                raise Unreachable(f"{self.server}: answers, and not as calrig does") from error

    @contextmanager
    def _answer(self, request: Request) -> Iterator[HTTPResponse]:
        try:
            with closing(self._open(request, timeout=PATIENCE_S)) as answer:
                yield answer
        except HTTPError as error:
            kind = Invalid if error.code == INVALID else Refused
            raise kind(f"{self.server}: {self._detail(error)}", error.code) from error
        except (HTTPException, OSError) as error:
            raise self._unreachable(error) from error

    def _unreachable(self, error: Exception) -> Unreachable:
        return Unreachable(f"{self.server}: {why_unreachable(error)}")

    def _detail(self, error: HTTPError) -> str:
        to = error.headers.get("Location")
        if to is not None:
            return f"sends on to {printable(to)}: name that address, if calrig is there"
        try:
            said = str(json.load(error)["detail"])
        except (ValueError, KeyError, TypeError, HTTPException, OSError):
            said = f"answers {error.code} {error.reason}"
        if error.code != HTTPStatus.UNAUTHORIZED:
            return said
        return f"{said}; calrig shows that of CALRIG_TOKEN" + ("" if self._token() else ", which is not set")


def part(answer: Any, name: str) -> Any:
    """A field of an answer.

    Raises:
        Unreachable: it has none: whoever answers is not calrig.
    """
    try:
        return answer[name]
    except (KeyError, TypeError) as error:
        raise Unreachable(f"the service answers, and not as calrig does (no {name!r})") from error


"""Bytes sent at once."""


class Upload:
    """The body of a request: its length and its pieces.

    Args:
        file: sent under its name as the field `file`.
        fields: the others.
        told: the share that is sent, 0 to 1, again and again.

    Raises:
        InputError: the file cannot be read.
    """

    def __init__(self, file: Path, fields: Mapping[str, str], told: Callable[[float], None]) -> None:
        self._name, self._told = str(file), told
        with ExitStack() as stack:
            try:
                self._file: IO[bytes] = stack.enter_context(file.open("rb"))
                if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                    # a pipe does not know its length, which comes first
                    piped, self._file = self._file, stack.enter_context(TemporaryFile())
                    copyfileobj(piped, self._file)
                self._n_bytes = self._file.seek(0, os.SEEK_END)
            except OSError as error:
                raise InputError(f"{file}: cannot be read ({error.strerror})") from error
            self._opened = stack.pop_all()
        boundary = secrets.token_hex(16)
        self.content_type = f"multipart/form-data; boundary={boundary}"
        head = [
            f'--{boundary}\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n'
            for k, v in fields.items()
        ]
        name = os.fsencode(file.name).decode("utf-8", "backslashreplace")
        for plain, escaped in (('"', "%22"), ("\r", "%0D"), ("\n", "%0A")):  # as the HTML standard has it
            name = name.replace(plain, escaped)
        head.append(
            f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
            "Content-Type: text/csv\r\n\r\n"
        )
        self._head = "".join(head).encode("utf-8", "surrogateescape")
        self._tail = f"\r\n--{boundary}--\r\n".encode()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def __len__(self) -> int:
        return len(self._head) + self._n_bytes + len(self._tail)

    def __iter__(self) -> Iterator[bytes]:
        yield self._head
        self._file.seek(0)
        left = self._n_bytes
        while left:
            piece = self._file.read(min(PIECE, left))
            if not piece:
                raise InputError(f"{self._name}: has become shorter while it was sent")
            nap()
            yield piece
            left -= len(piece)
            self._told(1.0 - left / self._n_bytes)
        yield self._tail
