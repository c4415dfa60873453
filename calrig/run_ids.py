"""Ids of runs: UUIDs, minted where a run begins; numbers in stores older than that."""

import re
import uuid

_FORM = "00000000-0000-0000-0000-000000000000"
_UUID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", re.ASCII)
_NUMBER = re.compile(r"[1-9][0-9]{0,17}", re.ASCII)
FEWEST = 6
"""Characters that a UUID may be shortened to where a person types it."""


def new_run_id() -> str:
    """An id that no other run has, on whichever bench it begins."""
    return str(uuid.uuid4())


def is_uuid(text: str) -> bool:
    """Whether text is a UUID as it is written in an id: lower case, with hyphens."""
    return _UUID.fullmatch(text) is not None


def is_number(text: str) -> bool:
    """Whether text is the id of a run from the time when they were counted."""
    return _NUMBER.fullmatch(text) is not None


def is_run_id(text: str) -> bool:
    """Whether a run could have this id."""
    return is_uuid(text) or is_number(text)


def short_name(run_id: str) -> str:
    """What a run is called where there is little room: a UUID by its first 8 characters."""
    return run_id[:8] if is_uuid(run_id) else run_id


def begins_uuid(text: str) -> bool:
    """Whether text is a UUID, or as much of one's beginning as a person may type for it."""
    return FEWEST <= len(text) <= len(_FORM) and is_uuid(text + _FORM[len(text) :])
