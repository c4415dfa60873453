"""The revisions of the tables, and their migrations on a connection that its database has made ready.

A revision is the four digits its file in migrations/versions begins with, so that the newest one is found
without importing Alembic, which is needed only when there is something to do.
"""

from __future__ import annotations

import re

from sqlalchemy import Connection

from calrig.settings import packed
from calrig.store.errors import StoreError


def revisions() -> list[str]:
    """The program's revisions, oldest first."""
    found = (
        re.match(r"(\d{4})_\w+\.py$", file.name) for file in (packed("migrations") / "versions").iterdir()
    )
    known = sorted(match[1] for match in found if match)
    if not known:
        raise StoreError(f"{packed('migrations')}: holds no migrations: install calrig again")
    return known


def migrate(connection: Connection) -> None:
    """Brings the tables to the program's revision, inside the transaction that the connection is in."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(packed("migrations")).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
