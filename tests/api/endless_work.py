"""Heavy work that never ends, or that waits for who watches. The processes import this: it imports little."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

if (
    "CALRIG_TEST_AT_WORK" not in os.environ
):  # in the process of the tests; those that its services start have it
    os.environ["CALRIG_TEST_AT_WORK"] = tempfile.mkdtemp(prefix="calrig-at-work-")
    atexit.register(shutil.rmtree, os.environ["CALRIG_TEST_AT_WORK"])
AT_WORK = Path(os.environ["CALRIG_TEST_AT_WORK"])
"""Where the processes for heavy work say that they have begun."""


SEEN = AT_WORK / "seen"
"""How far the watched work is, as who watches it has seen last."""


def watched(*poses: Any, progress: Callable[[float], None], **asked: Any) -> dict[str, Any]:
    """As `calrig.analysis.diagnoses.traced`; goes on whenever somebody has seen how far it is."""
    from calrig.analysis.diagnoses import traced

    def told(share: float) -> None:
        progress(share)
        _until_seen(share)

    _until_seen(0.0)
    return traced(*poses, progress=told, **asked)


def see(share: float) -> None:
    """Somebody has seen that the watched work is so far."""
    unfinished = SEEN.with_suffix(".new")
    unfinished.write_text(str(share))
    unfinished.replace(SEEN)


def _until_seen(share: float) -> None:
    give_up_s = time.monotonic() + 60.0  # of a test that has failed
    while (not SEEN.exists() or float(SEEN.read_text()) < share) and time.monotonic() < give_up_s:
        time.sleep(0.005)


def for_ever(*_: Any, **__: Any) -> None:
    """A piece of work, in a process of the service in this process."""
    (AT_WORK / str(os.getpid())).touch()
    time.sleep(3600.0)


def working() -> list[int]:
    """The processes that carry out such a piece."""
    return [pid for one in AT_WORK.glob("[0-9]*") if _is_there(pid := int(one.name))]


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
