"""URL by which a bench reaches its centre's database."""

from __future__ import annotations

from ipaddress import ip_address

from sqlalchemy import URL


def agent_url(centre: URL, role: str, password: str, host: str | None, port: int | None) -> URL:
    """The centre's own URL with the bench's name and password, as agents reach it.

    Across a network the server has to prove by its certificate who it is (`verify-full`).

    Args:
        centre: by which the centre reaches the database.
        role: of the bench.
        password: of the role.
        host: by which agents reach the server; None where the centre's does.
        port: likewise.
    """
    place = centre if host is None else centre.set(host=host, query={})
    place = place.set(port=place.port if port is None else port)
    # of the rest of the query nothing: certificates and options are those of the centre's own connections
    query = {key: value for key, value in place.query.items() if key in {"host", "port"}}
    if not is_on_this_machine(place):
        query["sslmode"] = "verify-full"
    return place.set(drivername="postgresql+psycopg", username=role, password=password, query=query)


def is_on_this_machine(url: URL) -> bool:
    """Whether the database is reached by a socket or by loopback, as from no other machine."""
    host = url.host or url.query.get("host") or ""
    if not isinstance(host, str):
        return False  # several servers
    if not host or host.startswith(("/", "@")) or host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
