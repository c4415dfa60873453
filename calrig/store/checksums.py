"""Checksums of stored values: SQLite detects a page out of order, but not a changed digit."""

import json
import math
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import JSON, Dialect, TypeDecorator

from calrig.store.errors import Unreadable

KEY = " crc32"
"""What a stored document has beside its own keys. No column of a file is called so: names are stripped."""


def of_numbers(numbers: Iterable[float | None]) -> int:
    """CRC-32 of numbers in a row; None counts as what is not known."""
    # SQLite keeps no sign of a zero; adding one takes it away.
    values = [math.nan if number is None else number + 0.0 for number in numbers]
    return zlib.crc32(struct.pack(f"<{len(values)}d", *values))


def of_rows(numbers: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(N,) the same of each row of numbers (N, p), NaN where one is not known."""
    rows = np.ascontiguousarray(np.where(np.isnan(numbers), math.nan, numbers + 0.0), dtype="<f8")
    each = rows.view(f"V{8 * rows.shape[1]}").ravel().tolist() if rows.size else []
    return np.fromiter(map(zlib.crc32, each), dtype=np.float64, count=len(rows))


def check_numbers(stored: int | None, numbers: Iterable[float | None], what: str) -> None:
    """Raises Unreadable where numbers are not those stored; rows older than checksums have None."""
    try:
        found = of_numbers(numbers)
    except TypeError as error:  # SQLite keeps anything in any column
        raise Unreadable(f"{what} is not what was stored: there is no number where one belongs") from error
    if stored is not None and stored != found:
        raise Unreadable(f"{what} is not what was stored")


def to_json(value: object) -> str:
    """JSON as it is stored: the same text for the same document."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


class CheckedJson(TypeDecorator[dict[str, Any]]):
    """A document as JSON, with the CRC-32 of its text as one more key. One without is from before."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def process_bind_param(self, value: Any | None, dialect: Dialect) -> dict[str, Any] | None:  # noqa: ARG002
        """Python to database."""
        return None if value is None else sealed(value)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> dict[str, Any] | None:  # noqa: ARG002
        """Database to Python."""
        return None if value is None else unsealed(value)


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with the checksum of its text as one more key."""
    return {**document, KEY: zlib.crc32(to_json(document).encode())}


def unsealed(value: Any) -> dict[str, Any]:
    """The document that was sealed; Unreadable where it is another one. One without a checksum is taken."""
    stored = value.pop(KEY, None) if isinstance(value, dict) else 0
    try:
        text = to_json(value) if stored is not None else json.dumps(value, ensure_ascii=False)
        found = zlib.crc32(text.encode())
    except (ValueError, RecursionError) as error:  # no number, no text, or nested too deeply
        raise Unreadable(f"a document is not what was stored: {error}") from error
    if stored is not None and stored != found:
        raise Unreadable("a document is not what was stored")
    return dict(value)


def from_json(text: str) -> Any:
    """What JSON text holds; Unreadable where it is no JSON any more."""
    try:
        return json.loads(text)
    except (ValueError, TypeError, RecursionError) as error:
        raise Unreadable(f"a document is no JSON any more: {error}") from error
