"""HTTP to a running service with the token of CALRIG_TOKEN: JSON, text, files, streams of lines."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from http.client import HTTPException, HTTPResponse
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import BaseHandler, HTTPSHandler, ProxyHandler, Request, build_opener

from calrig.client.errors import INVALID, Invalid, Refused, Unreachable
from calrig.errors import InputError

if TYPE_CHECKING:
    import ssl

    from calrig.client.upload import Upload

PATIENCE_S = 30.0
"""Without a byte; a stream that has nothing to tell sends a comment every 12 s."""


class Transport:
    """The service at an address such as `http://lab-pc:8000`.

    Attributes:
        server: the address.
    """

    def __init__(
        self, server: str, certificates: ssl.SSLContext | None = None, *, token: str | None = None
    ) -> None:
        """Nothing is sent yet.

        Args:
            server: `http` or `https`, with whatever path a proxy has it under.
            certificates: whose are believed; without it those that this machine trusts.
            token: shown to this address alone; without it that of CALRIG_TOKEN, where it is set.

        Raises:
            InputError: it is no such address.
        """
        if urlsplit(server).scheme not in {"http", "https"} or not urlsplit(server).netloc:
            raise InputError(f"{server}: is no address such as http://lab-pc:8000")
        self.server = server.rstrip("/")
        self._token = token
        handlers: list[BaseHandler] = [HTTPSHandler(context=certificates)]
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
        with self._answer(self._request(path)) as answer:
            return answer.read().decode()

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
        token = self._token or os.environ.get("CALRIG_TOKEN")
        if token:
            if not (token.isascii() and token.isprintable()):
                raise InputError("CALRIG_TOKEN: a token is printable ASCII")
            # not where a redirection leads: the token is for the address that was given
            request.add_unredirected_header("Authorization", f"Bearer {token}")
        return request

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
            raise kind(f"{self.server}: {_detail(error)}", error.code) from error
        except (URLError, HTTPException, OSError) as error:
            raise self._unreachable(error) from error

    def _unreachable(self, error: Exception) -> Unreachable:
        reason = getattr(error, "reason", None) or error
        return Unreachable(f"{self.server}: does not answer ({reason})")


def is_loopback(host: str) -> bool:
    """Whether a host is this machine, whatever names are resolved to."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _detail(error: HTTPError) -> str:
    try:
        return str(json.load(error)["detail"])
    except (ValueError, KeyError, TypeError):
        return f"answers {error.code} {error.reason}"
