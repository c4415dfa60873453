"""Users, people and programs: identified by a token, stored as its hash, or by a proxy."""

import hashlib
import re
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import get_args

from sqlmodel import Session, col, select

from calrig.model.service import Role
from calrig.store.database import Repository, row_of
from calrig.store.errors import Refused, Unreadable
from calrig.store.tables import UserTable
from calrig.store.trail import Act, append

ROLES: tuple[Role, ...] = get_args(Role)
NAME = re.compile(r"[\w.@+-]{1,64}")
PREFIX = "calrig_"
"""Of every token made here: whoever finds one in a repository sees what it opens."""


@dataclass(frozen=True, slots=True)
class User:
    """Somebody who is known; `token_sha256` is None for who is known by a proxy only."""

    name: str
    role: Role
    token_sha256: str | None
    created_at: datetime
    disabled_at: datetime | None

    @property
    def has_token(self) -> bool:
        """Whether the user may log in by a token."""
        return self.token_sha256 is not None


class Users(Repository):
    """Who is known. Each change goes into the trail in the same transaction."""

    def all(self) -> list[User]:
        """Everybody by name, those who were disabled as well."""
        with self._database.reading() as session:
            return [_user(row) for row in session.exec(select(UserTable).order_by(col(UserTable.name)))]

    def add(
        self, name: str, role: Role, *, with_token: bool = True, who: str | None = None
    ) -> tuple[User, str | None]:
        """Makes somebody known, or once more who was disabled; the token is told here and never again.

        Raises:
            Refused: there is such a user, or the name has characters that no name has.
        """
        if not NAME.fullmatch(name):
            raise Refused(f"a user's name has 1 to 64 letters, digits and . _ @ + -, unlike {name[:80]!r}")
        now, token = datetime.now(UTC), _new_token() if with_token else None
        with self._database.writing() as session:
            row = session.get(UserTable, name)
            if row is not None and row.disabled_at is None:
                raise Refused(f"there is a user {name!r} already: give them a new token, or disable them")
            if row is None:
                row = UserTable(name=name, role=role, created_at=now)
                session.add(row)
            row.role, row.disabled_at = role, None
            row.token_sha256 = None if token is None else token_digest(token)
            append(session, Act("user_added", who=who, detail={"name": name, "role": role}), now)
            return _user(row), token

    def new_token(self, name: str, *, who: str | None = None) -> tuple[User, str]:
        """Gives a user a token in place of the one before, which opens nothing from then on.

        Raises:
            NotFound: there is no such user.
            Refused: they were disabled.
        """
        token = _new_token()
        with self._database.writing() as session:
            row = _enabled(session, name)
            row.token_sha256 = token_digest(token)
            append(session, Act("user_changed", who=who, detail={"name": name, "changed": "token"}))
            return _user(row), token

    def set_role(self, name: str, role: Role, *, who: str | None = None) -> User:
        """Gives a user another role.

        Raises:
            NotFound: there is no such user.
            Refused: they were disabled, or are the last admin.
        """
        with self._database.writing() as session:
            row = _enabled(session, name)
            if role != "admin":
                _refuse_last_admin(session, row)
            row.role = role
            detail = {"name": name, "changed": "role", "role": role}
            append(session, Act("user_changed", who=who, detail=detail))
            return _user(row)

    def disable(self, name: str, *, who: str | None = None) -> User:
        """Lets a user in no more, by token or by proxy; what they did stays theirs.

        Raises:
            NotFound: there is no such user.
            Refused: they were disabled before, or are the last admin.
        """
        with self._database.writing() as session:
            row = _enabled(session, name)
            _refuse_last_admin(session, row)
            row.token_sha256, row.disabled_at = None, datetime.now(UTC)
            append(session, Act("user_changed", who=who, detail={"name": name, "changed": "disabled"}))
            return _user(row)


def token_digest(token: str) -> str:
    """What is kept of a token. It is random and long: nothing slower than SHA-256 would protect it better."""
    return hashlib.sha256(token.encode()).hexdigest()


def _new_token() -> str:
    return PREFIX + secrets.token_urlsafe(24)


def _enabled(session: Session, name: str) -> UserTable:
    row = row_of(session, UserTable, name, f"there is no user {name!r}")
    if row.disabled_at is not None:
        raise Refused(f"{name} was disabled: add them again")
    return row


def _refuse_last_admin(session: Session, row: UserTable) -> None:
    """The last admin stays: without one nobody could add the next, and the service would be open again."""
    admins = select(UserTable.name).where(UserTable.role == "admin", col(UserTable.disabled_at).is_(None))
    if session.exec(admins).all() == [row.name]:
        raise Refused(f"{row.name} is the last admin: make somebody else one first")


def _user(row: UserTable) -> User:
    if row.role not in ROLES:
        raise Unreadable(f"user {row.name} is not what was stored: there is no role {row.role[:40]!r}")
    return User(row.name, row.role, row.token_sha256, row.created_at, row.disabled_at)
