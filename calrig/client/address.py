"""The address of a service, looked at before anything is sent there; why nobody answers at it."""

from __future__ import annotations

import ssl
from ipaddress import ip_address
from urllib.parse import urlsplit

from calrig.errors import InputError


def checked(server: str) -> str:
    """The address of a service, without a slash at its end.

    Raises:
        InputError: it is none, or has a secret in it.
    """
    try:
        named = urlsplit(server)
        is_one = named.scheme in {"http", "https"} and bool(named.hostname) and named.port != 0
    except ValueError:  # no such port, or half an IPv6 address
        is_one = False
    if is_one and named.username is not None:
        raise InputError(
            f"{named.scheme}://…@{named.netloc.rpartition('@')[2]}: a name and a password are not shown to "
            "calrig: name the address without them, the token goes into CALRIG_TOKEN"
        )
    if not is_one or named.query or named.fragment or any(c.isspace() for c in server):
        raise InputError(f"{server}: is no address such as http://lab-pc:8000")
    return server.rstrip("/")


def is_loopback(host: str) -> bool:
    """Whether a host is this machine, whatever names are resolved to."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def why_unreachable(error: Exception) -> str:
    """Why nobody answers as calrig does, and what to do where that is known."""
    reason = getattr(error, "reason", None) or error
    if isinstance(reason, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not believed ({reason.verify_message}): name the file of your own authority "
            "by SSL_CERT_FILE, `calrig agent enroll` by --ca, in Python by Client(…, certificates=…)"
        )
    if isinstance(reason, ssl.SSLError):
        return f"does not speak TLS ({reason.reason}): is its address http://…?"
    if isinstance(reason, ConnectionRefusedError):
        return "does not answer: nothing listens there; is `calrig serve` running?"
    return f"does not answer ({getattr(reason, 'strerror', None) or reason})"
