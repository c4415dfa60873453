"""What every run begins with, measured or imported: the unit it is of, and where it comes from."""

from __future__ import annotations

import platform
from typing import Any

import calrig
from calrig.analysis.errors import Invalid

LONGEST_SERIAL = 100


def check_serial(serial: str) -> None:
    """Raises Invalid unless a serial number has 1 to 100 printable characters without blanks at its ends."""
    if not serial or serial != serial.strip() or not serial.isprintable():
        raise Invalid(
            "a unit's serial number is made of printable characters, without blanks at its ends", ["unit"]
        )
    if len(serial) > LONGEST_SERIAL:
        said = f"a unit's serial number has at most {LONGEST_SERIAL} characters, not {len(serial)}"
        raise Invalid(said, ["unit"])


def provenance(operator: str | None) -> dict[str, Any]:
    """What is known of a run's origin before any device has been asked: program, machine, operator."""
    return {
        "calrig": calrig.__version__,
        "python": platform.python_version(),
        "host": platform.node(),
        "operator": operator,
    }
