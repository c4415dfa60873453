"""Who may speak to the service: the token that is asked for, and the names it is known by."""

from __future__ import annotations

import os
import re
import socket
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import TYPE_CHECKING

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
        token: what has to be shown; None where whoever reaches the address may do everything.
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
