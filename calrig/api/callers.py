"""Who asks: the name, where somebody is known by name, and what they may do."""

# No `from __future__ import annotations`: FastAPI reads the annotations of the dependencies.

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from calrig.store.users import ROLES, Role, User

KEY = "calrig_caller"
"""Where a request's state holds its caller."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks; `name` is None where nobody is known by name."""

    name: str | None
    role: Role

    def may(self, role: Role) -> bool:
        """Whether their role is this one or more."""
        return ROLES.index(self.role) >= ROLES.index(role)


ANYBODY = Caller(None, "admin")
"""Who has the service's one token; everybody, where the service asks for none."""


class People:
    """The users, in memory: a stop never waits for the store to say who it is that asks for it.

    Args:
        users: reads them; only this service changes them, for a store has one writer.
    """

    def __init__(self, users: Callable[[], Iterable[User]]) -> None:
        self._read = users
        self._turn = threading.Lock()
        self.reread()

    def reread(self) -> None:
        """Looks into the store again; whoever changes users calls this before it answers."""
        with self._turn:
            enabled = [user for user in self._read() if user.disabled_at is None]
            # By digest: how long a look-up takes then says nothing about the tokens that are known.
            self._by_token = {u.token_sha256: Caller(u.name, u.role) for u in enabled if u.token_sha256}
            self._by_name = {u.name: Caller(u.name, u.role) for u in enabled}

    def of_token(self, sha256: str) -> Caller | None:
        """Whose token has this digest."""
        return self._by_token.get(sha256)

    def of_name(self, name: str) -> Caller | None:
        """The user of this name, who may come in."""
        return self._by_name.get(name)

    def __bool__(self) -> bool:
        return bool(self._by_name)

    @property
    def have_admin(self) -> bool:
        """Whether somebody among them can add the next one."""
        return any(caller.role == "admin" for caller in self._by_name.values())


def know(asked: HTTPConnection, caller: Caller) -> None:
    """Notes who sends a request."""
    asked.scope.setdefault("state", {})[KEY] = caller


def caller_of(asked: HTTPConnection) -> Caller | None:
    """Who sends a request; None where it is open to strangers and was sent by one."""
    found = asked.scope.get("state", {}).get(KEY)
    return found if isinstance(found, Caller) else None


def described(asked: HTTPConnection) -> str:
    """A request in a refusal: what was asked for, and from where."""
    return f"{asked.scope['method']} {asked.scope['path'][:200]!a} from {address_of(asked)}"


def address_of(asked: HTTPConnection) -> str:
    """Where a request came from."""
    return asked.client.host if asked.client else "an unknown address"


# In the event loop, all of these: a plain function would wait for a thread, and a stop with it.
async def _name(request: Request) -> str | None:
    caller = caller_of(request)
    return None if caller is None else caller.name


Who = Annotated[str | None, Depends(_name)]
"""The name of whoever asks, as the trail keeps it; None where nobody is known by name."""


def requires(role: Role) -> Any:
    """A dependency of a path that is not open to everybody: 403 to whoever has a lesser role."""

    async def check(request: Request) -> None:
        caller = caller_of(request)
        if caller is not None and caller.may(role):
            return
        who = "nobody" if caller is None else f"{caller.name or 'whoever asks'} ({caller.role})"
        enough = " or ".join(ROLES[ROLES.index(role) :])
        raise HTTPException(
            403,
            f"{described(request)}: {who} may not do this: it takes the role {enough}, which an admin gives "
            f"(`calrig users role NAME {role}`)",
        )

    return Depends(check)
