"""Access to the service: token and host names, callers and roles, trust levels, and attempts at a code."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Depends, Request
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from calrig.model.service import Role
from calrig.store.users import ROLES, User

if TYPE_CHECKING:
    from calrig.settings import Settings


TOKEN = "CALRIG_TOKEN"  # noqa: S105 (the variable's name)
LEAST_TOKEN = 16
MAKE_ONE = "python3 -c 'import secrets; print(secrets.token_urlsafe(24))'"
_TOKEN_FORM = re.compile(r"[\x21-\x7e]+")


class AccessError(Exception):
    """The service would be open to people it is not meant for; the message says what to set."""


@dataclass(frozen=True)
class Access:
    """What a service asks of those who speak to it.

    Attributes:
        token: required of clients; None where every client that reaches the address may do everything.
        names: host names, in lower case, that it answers to besides the address a connection came in at.
        patience_s: how late a wrong token is answered.
        proxies: networks of the proxies that say whom they let in.
        user_header: the header, in lower case, in which they say it.
    """

    token: str | None = None
    names: frozenset[str] = frozenset()
    patience_s: float = 1.0
    proxies: tuple[IPv4Network | IPv6Network, ...] = ()
    user_header: str = "x-forwarded-user"

    def trusts(self, address: str) -> bool:
        """Whether a proxy at this address is believed."""
        found = address_in(address)
        return found is not None and any(found in network for network in self.proxies)


def access_of(token: str | None, *, host: str, bound_to: str, settings: Settings, own_name: str) -> Access:
    """The access that a configuration means.

    Args:
        token: the value of CALRIG_TOKEN; None where it is not set.
        host: the host to listen on, as it was told.
        bound_to: its address.
        settings: `hosts`, further names (somebody is to come in from elsewhere), and trusted proxies.
        own_name: what this machine calls itself.

    Raises:
        AccessError: others can reach the service and there is no token, or the token is no good.
    """
    named = frozenset(name.lower() for name in settings.hosts)
    outside = not is_loopback(bound_to)
    if token is None and not settings.trusted_proxies and (outside or named):
        why = f"{host} can be reached from other machines" if outside else "calrig.toml has `hosts`"
        raise AccessError(f"{why}: set {TOKEN} to a token of your own, made by {MAKE_ONE}")
    if token is not None and (len(token) < LEAST_TOKEN or not _TOKEN_FORM.fullmatch(token)):
        raise AccessError(
            f"{TOKEN} must have {LEAST_TOKEN} ASCII characters or more and no space: make one by {MAKE_ONE}"
        )
    own = {host.lower(), own_name.lower(), f"{own_name.lower()}.local"} if outside else set()
    return Access(
        token,
        named | own,
        proxies=settings.trusted_proxies,
        user_header=settings.user_header.lower(),
    )


def access_here(host: str, bound_to: str, settings: Settings) -> Access:
    """As `access_of`, with the token of this process and the name of this machine."""
    token, name = os.environ.get(TOKEN), socket.gethostname()
    return access_of(token, host=host, bound_to=bound_to, settings=settings, own_name=name)


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach the address."""
    found = address_in(address)
    return found is not None and found.is_loopback


def address_in(text: str) -> IPv4Address | IPv6Address | None:
    """The address that a text is; None where it is a name."""
    try:
        found = ip_address(text)
    except ValueError:
        return None
    return (isinstance(found, IPv6Address) and found.ipv4_mapped) or found


def network_of(address: str) -> str | None:
    """What one client has to itself: an IPv4 address, 64 bits of IPv6.

    None for loopback: everybody on this machine comes from there, and whom a proxy on it lets in.
    """
    found = address_in(address)
    if found is None:
        return address
    if found.is_loopback:
        return None
    return str(found) if found.version == 4 else str(ip_network((found, 64), strict=False))


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

    `users` reads them; only this service changes them, for a store has one writer.
    """

    def __init__(self, users: Callable[[], Iterable[User]]) -> None:
        self._read = users
        self._turn = threading.Lock()
        self.reread()

    def reread(self) -> None:
        """Read the users from the store again; call this after every change, before answering."""
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


def share_of(asked: HTTPConnection) -> str:
    """Whose share of heavy work a request takes: the user's, or that of the network that it came from."""
    caller = caller_of(asked)
    if caller is not None and caller.name is not None:
        return f"user {caller.name}"
    address = address_of(asked)
    return f"address {network_of(address) or address}"


# In the event loop, all of these: a plain function would wait for a thread, and a stop with it.
async def _name(request: Request) -> str | None:
    caller = caller_of(request)
    return None if caller is None else caller.name


Who = Annotated[str | None, Depends(_name)]
"""The caller's name, as the audit log keeps it; None where no user is known by name."""


def requires(role: Role) -> Any:
    """Return a dependency that answers 403 to callers with a lesser role."""

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


CLOSE = {"Connection": "close"}
"""Headers of a refusal: the connection is closed after it."""
PLACE_KEY = "calrig_place"
"""Where a request's state holds the place of its connection."""


class Standing(Enum):
    """Who a client is."""

    STRANGER = "has not shown who it is"
    ANYBODY = "is not asked who it is, since the service has no token"
    KNOWN = "has shown the token, or a session begun with it"


@dataclass(eq=False)
class Place:
    """Trust level of one connection."""

    standing: Standing = Standing.STRANGER


def place_of(asked: HTTPConnection) -> Place:
    """The place of the connection that a request came by; one that nobody looks at where there is none."""
    place = asked.scope.get("state", {}).get(PLACE_KEY)
    return place if isinstance(place, Place) else Place()


MOST_EACH = 5
MOST_ALL = 100
"""Wrong ones within FORGOTTEN_S, from one address and from all: the memory is that of so many."""
FORGOTTEN_S = 60.0


class Attempts:
    """Wrong attempts of the last minute, by address.

    `clock` tells the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._turn = threading.Lock()
        self._wrong: list[tuple[float, str]] = []

    def begin(self, asked: HTTPConnection) -> tuple[float, str]:
        """Counts an attempt as wrong until it is `right`: those that come at once are each counted.

        Raises:
            HTTPException: 429, too many wrong ones came within the last minute.
        """
        address, now_s = address_of(asked), self._clock()
        network = network_of(address) or address
        with self._turn:
            self._wrong = [one for one in self._wrong if now_s - one[0] < FORGOTTEN_S]
            from_there = sum(one[1] == network for one in self._wrong)
            if from_there >= MOST_EACH or len(self._wrong) >= MOST_ALL:
                reason = f"too many wrong codes from {address}: try again in a minute"
                raise HTTPException(429, reason, {"Retry-After": f"{FORGOTTEN_S:.0f}"})
            self._wrong.append((now_s, network))
        return now_s, network

    def right(self, attempt: tuple[float, str]) -> None:
        """Takes back that an attempt was counted."""
        with self._turn:
            if attempt in self._wrong:
                self._wrong.remove(attempt)
