"""Errors of the store. Each message says what to do."""


class StoreError(Exception):
    """The store cannot be used. The message names the file, what happened and what to do."""


class AddressOfNoStoreError(StoreError):
    """What was given is neither a file's path nor the URL of a database that can hold a store."""


class NotFound(StoreError):  # noqa: N818 (an answer, not a fault)
    """There is no such run or revision, or the run has no such pose."""


class Refused(StoreError):  # noqa: N818 (an answer, not a fault)
    """What is stored does not allow this; the message says why and what to do."""


class ChangedMeanwhile(Refused):
    """Somebody else has written since it was read: read it again."""


class NoStore(StoreError):  # noqa: N818 (an answer, not a fault)
    """There is no store yet at the place that is to be read."""


class NotText(StoreError):  # noqa: N818 (likewise)
    """What was to be stored or looked for is no text that a store keeps: no UTF-8, or with a NUL in it."""


class Taken(StoreError):  # noqa: N818 (likewise)
    """Another program writes to the store; the message says which.

    Attributes:
        is_served: whether that one can be asked over HTTP.
    """

    def __init__(self, said: str, *, is_served: bool = False) -> None:
        super().__init__(said)
        self.is_served = is_served


class StoreUnavailableError(StoreError):
    """The store cannot be used now: the disk is full, the file locked or read-only. Once mended, it can."""


class Unreadable(Exception):  # noqa: N818 (inside the store only, until the file's name is known)
    """Something stored is not what was written; becomes a `StoreDamagedError`."""


class StoreDamagedError(StoreError):
    """What is in the file is not what was written there."""
