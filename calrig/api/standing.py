"""What a connection's client has shown with its last request: by it places are kept or given away.

The server's side (`calrig.api.connections`) lays a `Place` into each request, the application notes in it
what it found out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from starlette.requests import HTTPConnection

KEY = "calrig_place"
"""Where a request's state holds the place of its connection."""


class Standing(Enum):
    """Who a client is."""

    STRANGER = "has not shown who it is"
    ANYBODY = "is not asked who it is, since the service has no token"
    KNOWN = "has shown the token, or a session begun with it"


@dataclass
class Place:
    """One connection's."""

    standing: Standing = Standing.STRANGER


def place_of(asked: HTTPConnection) -> Place:
    """The place of the connection that a request came by; one that nobody looks at where there is none."""
    place = asked.scope.get("state", {}).get(KEY)
    return place if isinstance(place, Place) else Place()
