"""Documents in JSON: read from a file, and the text that their hash is of (CONTRACT section 6)."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from calrig.errors import InputError


def canonical(document: Mapping[str, Any]) -> str:
    """Keys in order, no blanks, every character as it is."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def sha256_of(document: Mapping[str, Any]) -> str:
    """Of a document less its own `sha256`."""
    bare = {key: value for key, value in document.items() if key != "sha256"}
    return hashlib.sha256(canonical(bare).encode()).hexdigest()


def with_sha256(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with its own `sha256`."""
    return {**document, "sha256": sha256_of(document)}


def json_of_file(content: bytes, file: str, what: str) -> Any:
    """What a file holds that is to be `what`, such as "a plan"; InputError tells a mistake by its place."""
    try:
        return json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: is not UTF-8 text (byte {error.start})") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{file}, line {error.lineno}, column {error.colno}: {error.msg}") from error
    except RecursionError as error:
        raise InputError(f"{file}: is nested too deeply for {what}") from error
    except ValueError as error:  # Python reads no whole number of more than 4300 digits
        raise InputError(f"{file}: has a number in it of more digits than can be read") from error
