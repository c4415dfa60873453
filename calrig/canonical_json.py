"""The text of a document that its hash is of (CONTRACT section 6)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any


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
