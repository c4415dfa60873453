"""Work that takes long: a diagnosis that tells that two fifths are done, and what has to be cancelled.

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
