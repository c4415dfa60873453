"""Types of columns: times as text in UTC, hashes, checksums."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import BigInteger, Dialect, Integer, String, TypeDecorator

from calrig.store.errors import Unreadable


class UtcText(TypeDecorator[datetime]):
    """An aware time as ISO 8601 text in UTC of fixed width, so that text order is the order of time."""

    impl = String(32)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> str | None:  # noqa: ARG002
        """Python to database."""
        return None if value is None else value.astimezone(UTC).isoformat(timespec="microseconds")

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Database to Python."""
        try:
            return None if value is None else datetime.fromisoformat(value)
        except (TypeError, ValueError) as error:
            raise Unreadable(f"a time is no time any more: {value!r}") from error


Sha256 = String(64)
"""A hash in hexadecimal."""
Crc32 = BigInteger().with_variant(Integer(), "sqlite")
"""Unsigned 32 bits, one more than PostgreSQL's integer holds."""
