"""A piece of heavy work that never ends, and who is at it. The processes import this: it imports little."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

if (
    "CALRIG_TEST_AT_WORK" not in os.environ
):  # in the process of the tests; those that its services start have it
    os.environ["CALRIG_TEST_AT_WORK"] = tempfile.mkdtemp(prefix="calrig-at-work-")
    atexit.register(shutil.rmtree, os.environ["CALRIG_TEST_AT_WORK"])
AT_WORK = Path(os.environ["CALRIG_TEST_AT_WORK"])
"""Where the processes for heavy work say that they have begun."""


def for_ever(*_: Any, **__: Any) -> None:
    """A piece of work, in a process of the service in this process."""
    (AT_WORK / str(os.getpid())).touch()
    time.sleep(3600.0)


def working() -> list[int]:
    """The processes that carry out such a piece."""
    return [pid for one in AT_WORK.iterdir() if _is_there(pid := int(one.name))]


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
