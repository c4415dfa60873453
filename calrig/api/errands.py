"""Answers to what has a thread of its own, waited for in the event loop: no other request is in the way."""

from __future__ import annotations

import asyncio
from typing import TypeVar

from calrig.analysis.errors import Conflict
from calrig.runs.errands import Errand

MOST_S = 10.0
"""How long a stop is waited for: longer than any device takes that is not stuck in its system's driver."""
T = TypeVar("T")


async def answer_of(errand: Errand[T], stage: str) -> T:
    """What comes of a stop, which goes on whoever still waits for it.

    Raises:
        Conflict: not in time.
    """
    try:
        async with asyncio.timeout(MOST_S):
            return await asyncio.shield(asyncio.wrap_future(errand.future))
    except TimeoutError as error:
        raise Conflict(
            f"{stage} was told to stop and is not known to stand after {MOST_S:g} s: cut its motor power"
        ) from error
