"""Check the URL by which a bench reaches its centre's database."""

from __future__ import annotations

from sqlalchemy import make_url

from calrig.errors import InputError, WorkError
from calrig.store.engines import EXTRA, is_centre


def checked_url(url: str) -> str:
    """The URL of a centre's database in libpq's own form.

    Raises:
        InputError: it names none.
        WorkError: by it somebody on the network could listen, or take the centre's place.
    """
    if not is_centre(url):
        raise InputError("an agent needs the URL of its centre's database: --db postgresql+psycopg://…")
    try:
        import procrastinate  # noqa: F401 (whether they are there)
        import psycopg  # noqa: F401

        from calrig.store.postgresql.agent_url import is_on_this_machine
    except ModuleNotFoundError as error:
        raise WorkError(f"an agent needs {error.name}: {EXTRA}") from error
    parsed = make_url(url)
    if not is_on_this_machine(parsed) and parsed.query.get("sslmode") != "verify-full":
        shown = parsed.set(drivername="postgresql+psycopg").render_as_string(hide_password=True)
        raise WorkError(
            f"{shown}: a centre on another machine is reached by TLS that proves who it is: add "
            "?sslmode=verify-full (and sslrootcert=FILE) to the URL"
        )
    return parsed.set(drivername="postgresql").render_as_string(hide_password=False)
