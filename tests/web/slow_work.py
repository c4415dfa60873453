"""Work that takes long: a diagnosis, a plan that is looked for, of which two fifths are said to be done.

Its process imports little.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LET_GO = Path(tempfile.gettempdir()) / "calrig-test-of-slow-work"


def slow_trace(*poses: Any, progress: Callable[[float], None], **asked: Any) -> dict[str, Any]:
    """As `calrig.calibration.diagnosis.trace`, once LET_GO is there."""
    from calrig.calibration.diagnosis import trace

    progress(0.4)
    while not LET_GO.exists():
        time.sleep(0.02)
    return trace(*poses, **asked)


def slow_answer(asked: Any, progress: Callable[[float], None]) -> Any:
    """As `calrig.runs.plan_answers.answer`, once LET_GO is there."""
    from calrig.runs.plan_answers import answer

    progress(0.4)
    while not LET_GO.exists():
        time.sleep(0.02)
    return answer(asked)
