"""Why a request about runs cannot be met, in the three kinds that HTTP and the command line answer by."""

from __future__ import annotations


class RunsError(Exception):
    """A request that cannot be met; the message is one line that a person can act on."""


class Unknown(RunsError):  # noqa: N818 (read as a word: raise Unknown)
    """No such run, rig, unit or pose."""


class Conflict(RunsError):  # noqa: N818
    """The rig is busy, or the run is in a state that does not allow this."""


class NotTheSame(Conflict):
    """What an interrupted run was measured with is not there any more; it stays interrupted."""


class Invalid(RunsError):  # noqa: N818
    """The request itself is wrong: a serial number, a plan beyond the limits, a file that does not parse."""


LONGEST_REASON = 1000


def checked_reason(reason: str) -> str:
    """A reason without blanks at its ends; Invalid where there is none, or a whole book."""
    if not reason.strip():
        raise Invalid("a reason is needed: it stays with what is done")
    if len(reason) > LONGEST_REASON:
        raise Invalid(f"a reason has at most {LONGEST_REASON} characters, not {len(reason)}")
    return reason.strip()
