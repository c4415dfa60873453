"""Work that takes long: diagnosis, plan, follow-up, log say two fifths are done; what has to be cancelled.

Its process imports little.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

_OF_THESE_TESTS = f"{tempfile.gettempdir()}/calrig-slow-{os.getpid()}"
LET_GO = Path(os.environ.setdefault("CALRIG_TEST_LET_GO", _OF_THESE_TESTS))
"""Of this process of tests, and of those that its service starts: others beside it have one of their own."""


def slow_trace(*poses: Any, progress: Callable[[float], None], **asked: Any) -> dict[str, Any]:
    """As `calrig.analysis.diagnoses.traced`, once LET_GO is there."""
    from calrig.analysis.diagnoses import traced

    progress(0.4)
    held()
    return traced(*poses, **asked)


def slow_study(*_: Any, progress: Callable[[float], None], **__: Any) -> None:
    """In the place of `calrig.analysis.noise_studies.study_file`; ends with LET_GO."""
    progress(0.4)
    held()


def slow_design(*_: Any, progress: Callable[[float], None]) -> None:
    """In the place of `calrig.runs.follow_up.designed`; ends with LET_GO."""
    progress(0.4)
    held()


def held(*_: Any) -> None:
    """Work that somebody has to cancel; ends with LET_GO."""
    while not LET_GO.exists():
        time.sleep(0.02)


def slow_answer(asked: Any, progress: Callable[[float], None]) -> Any:
    """As `calrig.runs.plan_designs.answer`, once LET_GO is there."""
    from calrig.runs.plan_designs import answer

    progress(0.4)
    held()
    return answer(asked)
