"""A calibration document from a file or a service, refused where it is not as it was issued."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from calrig.canonical_json import sha256_of
from calrig.errors import InputError

SCHEMA = "calrig.calibration/2"
LARGEST = 10_000_000
"""Bytes; a document has some thousands."""
_NEEDED = ("unit", "range_deg", "bias_deg", "scale", "effects")


def read_document(source: str | Path) -> dict[str, Any]:
    """A document of CONTRACT section 6.

    Args:
        source: a file, or an address such as `http://lab-pc:8000/api/units/AS-0042/calibration`, which is
            asked with the token of CALRIG_TOKEN.

    Raises:
        InputError: it cannot be read, is no such document, or its `sha256` is that of another.
        WorkError: the service refuses or cannot be reached.
    """
    name = str(source)
    is_address = name.startswith(("http://", "https://"))
    return checked(_from_service(name) if is_address else _from_file(Path(source)), name)


def checked(document: Any, name: str) -> dict[str, Any]:
    """The same of JSON that has been read; `name` says where it is from."""
    if not isinstance(document, dict) or not str(document.get("schema")).startswith("calrig.calibration/"):
        raise InputError(f"{name}: is no calibration: `calrig export --unit SERIAL` prints one")
    if document["schema"] != SCHEMA:
        raise InputError(f"{name}: is a {str(document['schema'])[:40]}, and what is known here is {SCHEMA}")
    try:
        is_as_issued = document.get("sha256") == sha256_of(document)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: holds what no calibration does ({error})") from error
    if not is_as_issued:
        raise InputError(f"{name}: was changed since it was issued: its sha256 is not that of what it says")
    missing = [key for key in _NEEDED if key not in document]
    if missing:
        raise InputError(f"{name}: lacks {', '.join(missing)}")
    return document


def _from_file(file: Path) -> Any:
    try:
        with file.open("rb") as opened:
            content = opened.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    if len(content) > LARGEST:
        raise InputError(f"{file}: has more than {LARGEST} bytes, and no calibration has")
    try:
        return json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: is not UTF-8 text (byte {error.start})") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{file}, line {error.lineno}, column {error.colno}: {error.msg}") from error
    except RecursionError as error:
        raise InputError(f"{file}: is nested too deeply for a calibration") from error
    except ValueError as error:  # Python reads no whole number of more than 4300 digits
        raise InputError(f"{file}: has a number in it of more digits than can be read") from error


def _from_service(address: str) -> Any:
    from calrig.client.transport import Transport

    try:
        parts = urlsplit(address)
    except ValueError as error:
        raise InputError(f"{address}: is no address ({error})") from error
    server = urlunsplit((parts.scheme, parts.netloc, "", "", ""))
    # what is issued has its hash in it, and may lie behind a link that lasts
    return Transport(server, follows=True).get(urlunsplit(("", "", parts.path or "/", parts.query, "")))
