"""A running service, spoken to over HTTP with the token of CALRIG_TOKEN."""

from __future__ import annotations

import json
import os
from http.client import HTTPException
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPSHandler, Request, build_opener

from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    import ssl

PATIENCE_S = 30.0
INVALID = 422


class Client:
    """The service at an address such as `http://lab-pc:8000`."""

    def __init__(self, server: str, certificates: ssl.SSLContext | None = None) -> None:
        """`certificates` says whose are believed; without it those that this machine trusts."""
        if urlsplit(server).scheme not in {"http", "https"} or not urlsplit(server).netloc:
            raise InputError(f"{server}: is no address such as http://lab-pc:8000")
        self._server = server.rstrip("/")
        self._open = build_opener(HTTPSHandler(context=certificates)).open

    def get(self, path: str) -> Any:
        """The JSON at a path.

        Raises:
            InputError: what was asked for is wrong.
            WorkError: the service refuses otherwise, or cannot be reached.
        """
        return self._ask(Request(self._server + path))  # noqa: S310 (http or https, as looked at above)

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """The answer to a body; as `get`."""
        data, headers = json.dumps(body).encode(), {"Content-Type": "application/json"}
        return self._ask(Request(self._server + path, data, headers))  # noqa: S310 (likewise)

    def delete(self, path: str) -> Any:
        """The answer to the end of what is at a path; as `get`."""
        return self._ask(Request(self._server + path, method="DELETE"))  # noqa: S310 (likewise)

    def _ask(self, request: Request) -> Any:
        token = os.environ.get("CALRIG_TOKEN")
        if token:
            # not where a redirection leads: the token is for the address that was given
            request.add_unredirected_header("Authorization", f"Bearer {token}")
        try:
            with self._open(request, timeout=PATIENCE_S) as answer:
                return json.load(answer)
        except HTTPError as error:
            kind = InputError if error.code == INVALID else WorkError
            raise kind(f"{self._server}: {_detail(error)}") from error
        except (URLError, HTTPException, OSError) as error:
            reason = getattr(error, "reason", None) or error
            raise WorkError(f"{self._server}: does not answer ({reason})") from error
        except ValueError as error:
            raise WorkError(f"{self._server}: answers, and not as calrig does") from error


def _detail(error: HTTPError) -> str:
    try:
        return str(json.load(error)["detail"])
    except (ValueError, KeyError, TypeError):
        return f"answers {error.code} {error.reason}"
