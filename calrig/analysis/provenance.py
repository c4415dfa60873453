"""Where a run comes from: program, machine, operator."""

from __future__ import annotations

import platform
from typing import Any

import calrig


def provenance(operator: str | None) -> dict[str, Any]:
    """What is known of a run's origin before any device has been asked."""
    return {
        "calrig": calrig.__version__,
        "python": platform.python_version(),
        "host": platform.node(),
        "operator": operator,
    }
