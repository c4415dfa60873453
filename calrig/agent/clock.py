"""Compare this machine's clock with that of the centre's database."""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from typing import Any

import psycopg

from calrig.model.clock_skew import is_refused, skew_in_words

LONGEST_S = 2.0
"""A round trip that takes longer says too little of the moment in it at which the server read its clock."""

log = logging.getLogger(__name__)


def utc_now() -> datetime:
    """The time by this machine's clock."""
    return datetime.now(UTC)


class ClockSkew:
    """How far this machine's clock is ahead of the server's, as it was measured last.

    Attributes:
        skew_s: None before it was measured.
    """

    def __init__(self) -> None:
        self.skew_s: float | None = None

    @property
    def is_refused(self) -> bool:
        """Whether the bench may act on no orders because of it."""
        return is_refused(self.skew_s)

    def measure(self, connection: psycopg.Connection[Any]) -> None:
        """Ask the server for its time, and compare it with the middle of the question."""
        before = utc_now()
        ((there,),) = connection.execute("SELECT clock_timestamp()").fetchall()
        took = utc_now() - before
        if took.total_seconds() > LONGEST_S:
            return
        was_refused = self.is_refused
        self.skew_s = (before + took / 2 - there).total_seconds()
        if self.is_refused is not was_refused:
            said = skew_in_words(self.skew_s) or "its clock agrees with the centre's again"
            log.warning("this bench: %s", said)
