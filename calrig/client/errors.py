"""What a service refuses, in its own words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calrig.errors import InputError, WorkError

if TYPE_CHECKING:
    from calrig.client.documents import RunRecord

CONFLICT = 409
INVALID = 422


class ServiceError(Exception):
    """The service did not do what it was asked; the message is the service's, after its address.

    Attributes:
        status: of HTTP; None where there was no answer.
    """

    def __init__(self, message: str, status: int | None = None) -> None:
        super().__init__(message)
        self.status = status


class Refused(ServiceError, WorkError):  # noqa: N818 (read as words: raise Refused)
    """It answers, and refuses: unknown (404), busy or in the wrong state (409), not allowed (401, 403)."""


class Invalid(ServiceError, InputError):  # noqa: N818
    """What was asked for is wrong (422)."""


class Unreachable(ServiceError, WorkError):  # noqa: N818
    """It does not answer, or not as calrig does."""


class RunFailed(WorkError):  # noqa: N818
    """A run has ended without being completed.

    Attributes:
        record: the run as it ended; its poses are kept.
    """

    def __init__(self, record: RunRecord) -> None:
        super().__init__(f"run {record.id} {record.status}" + (f": {record.error}" if record.error else ""))
        self.record = record
