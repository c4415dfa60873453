"""Why a request about runs cannot be met, in the three kinds that HTTP and the command line answer by."""

from collections.abc import Sequence


class RunsError(Exception):
    """A request that cannot be met; the message is one line that a person can act on.

    `fields` are the places in the request that are wrong, where it is one: `plan.stop_deg`.
    """

    def __init__(self, message: str, fields: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.fields = list(fields)


class Unknown(RunsError):  # noqa: N818 (read as a word: raise Unknown)
    """No such run, rig, unit or pose."""


class Conflict(RunsError):  # noqa: N818
    """The rig is busy, or the run is in a state that does not allow this."""


class NotTheSame(Conflict):
    """What an interrupted run was measured with is not there any more; it stays interrupted."""


class Invalid(RunsError):  # noqa: N818
    """The request itself is wrong: a serial number, a plan beyond the limits, a file that does not parse."""
