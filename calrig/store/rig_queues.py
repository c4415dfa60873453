"""The queue of a rig, in which a centre lays what the rig's bench is to carry out."""

from __future__ import annotations

import hashlib
import re

BENCH_NAME = re.compile(r"[A-Za-z0-9_.-]{1,20}")
"""Of a bench; a slash would make it another bench's queue."""
LONGEST_BYTES = 40
"""Of a queue: Procrastinate notifies on `procrastinate_queue_v1#` and its name, and PostgreSQL's longest
name of a channel has 63 bytes: a job in a longer one is refused.
"""


def queue_of(bench: str, rig: str) -> str:
    """The queue of a bench's rig; a long name of a rig is shortened to its hash.

    A bench's role sees the jobs of `rig:BENCH/…` (`calrig.store.postgresql.set_up`).
    """
    queue = f"rig:{bench}/{rig}"
    if len(queue.encode()) <= LONGEST_BYTES:
        return queue
    return f"rig:{bench}/~{hashlib.sha256(rig.encode()).hexdigest()[:12]}"
