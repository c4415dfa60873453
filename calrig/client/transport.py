"""HTTP to a running service with the token of CALRIG_TOKEN: JSON, text, files, streams of lines."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from http import HTTPStatus
from http.client import HTTPException, HTTPResponse, IncompleteRead
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import (
    BaseHandler,
    HTTPRedirectHandler,
    HTTPSHandler,
    ProxyHandler,
    Request,
    build_opener,
)

from calrig.client.address import checked, is_loopback, why_unreachable
from calrig.client.errors import INVALID, Invalid, Refused, Unreachable
from calrig.client.given_up import nap
from calrig.errors import InputError, printable

if TYPE_CHECKING:
    import ssl

    from calrig.client.upload import Upload

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
