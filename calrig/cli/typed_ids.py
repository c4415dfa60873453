"""Ids of runs as people type them: a UUID may be shortened to its first characters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from calrig.errors import InputError
from calrig.run_ids import begins_uuid, is_number

if TYPE_CHECKING:
    from calrig.store import Store

LISTED = 5
"""Of the runs that a beginning may mean."""


def looks_like_an_id(typed: str) -> bool:
    """Whether a person may mean a run by this; where a file is called so, the file is meant."""
    return is_number(typed) or begins_uuid(typed.lower())


def whole_id(store: Store, typed: str) -> str:
    """The id of the run that a person means; what was typed, where there is none.

    Raises:
        InputError: several ids begin so.
    """
    if not begins_uuid(typed.lower()) or store.run(typed) is not None:
        return typed
    return the_one(typed, store.uuids_beginning(typed.lower(), LISTED + 1))


def the_one(typed: str, found: Sequence[str]) -> str:
    """The id that begins so; what was typed, where there is none.

    Raises:
        InputError: several ids begin so.
    """
    if len(found) > 1:
        listed = ", ".join(found[:LISTED]) + (" and others" if len(found) > LISTED else "")
        raise InputError(f"run {typed}: several ids begin so ({listed}): type more of the one that is meant")
    return found[0] if found else typed
