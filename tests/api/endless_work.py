"""A piece of heavy work that never ends, and who is at it. The processes import this: it imports little."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any


def at_work(service: int) -> Path:
    """Where the processes for heavy work of a service say that they have begun."""
    folder = Path(tempfile.gettempdir()) / f"calrig-at-work-{service}"
    folder.mkdir(exist_ok=True)
    return folder


def for_ever(*_: Any, **__: Any) -> None:
    """A piece of work, in a process of the service in this process."""
    (at_work(os.getppid()) / str(os.getpid())).touch()
    time.sleep(3600.0)


def working() -> list[int]:
    """The processes that carry out such a piece."""
    return [pid for one in at_work(os.getpid()).iterdir() if _is_there(pid := int(one.name))]


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
