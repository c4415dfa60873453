"""Whose process listens at an address of this machine."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from urllib.parse import urlsplit

SOCKETS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
"""Linux: each socket with its address, state and user (proc_pid_net(5))."""
LISTENS = "0A"
WORD = 8
"""Hexadecimal digits of an address that are one number of the machine's byte order."""


def is_ours(address: str) -> bool:
    """Whether whoever answers at `http://127.0.0.1:8000` is a process of this user.

    A service lets its port go before its lock, and a port that is free is anybody's. True where the system
    does not tell.
    """
    named = urlsplit(address)
    try:
        host, port = ip_address(named.hostname or ""), named.port
    except ValueError:
        return False
    if not SOCKETS[0].exists():
        return True
    users = [user for where, at, user in _listeners() if at == port and _takes(where, host)]
    return bool(users) and set(users) == {os.geteuid()}


def _takes(where: IPv4Address | IPv6Address, host: IPv4Address | IPv6Address) -> bool:
    """Whether a socket that listens there may take what is sent to a host."""
    bound = getattr(where, "ipv4_mapped", None) or where
    is_any = where.is_unspecified and (where.version == 6 or host.version == 4)
    return bound == host or is_any


def _listeners() -> Iterator[tuple[IPv4Address | IPv6Address, int, int]]:
    """Address, port and user of each socket that listens."""
    for table in SOCKETS:
        if not table.exists():  # a machine without IPv6
            continue
        for line in table.read_text().splitlines()[1:]:
            _, local, _, state, _, _, _, user, *_ = line.split()
            if state == LISTENS:
                where, _, port = local.partition(":")
                words = (int(where[k : k + WORD], 16) for k in range(0, len(where), WORD))
                packed = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
                yield ip_address(packed), int(port, 16), int(user)
