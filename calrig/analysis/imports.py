"""The import of poses from a file: read and fitted without a store; and the checks of serial numbers."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import calrig
from calrig.analysis.errors import Invalid
from calrig.analysis.results import as_applied
from calrig.calibration.results import FittedResult, build_result
from calrig.export.calibration_document import calibration_content
from calrig.export.poses_csv import PoseColumns, read_run
from calrig.store.records import AcceptedEffect, Document

READING = 0.25
"""Share of an import that goes into reading its file."""


@dataclass(frozen=True, slots=True)
class Imported:
    """What a run is made of: the poses, what was said of the file, and CONTRACT section 2's result.

    `mount_axis` is which of the unit's axes lay along the stage's; there is a result about x alone. `content`
    is that of the unit's next revision, with the effects `accepted`; None where the scale is left open.
    """

    poses: PoseColumns
    mount_axis: str
    warnings: list[str]
    result: FittedResult | None
    content: Document | None
    accepted: Sequence[AcceptedEffect]


def read_and_fit(
    file: bytes | Path,
    unit: str,
    rig: str | None,
    accepted: Sequence[AcceptedEffect],
    progress: Callable[[float], None] | None = None,
) -> Imported:
    """Reads a CSV of poses (CONTRACT section 4) and fits them.

    Args:
        file: what is in it, or its path.
        unit: serial number.
        rig: that the poses were taken on; None where none is known.
        accepted: effects in force for its unit and rig.
        progress: told the share of the import that is done, 0 to 1; fitting and keeping tell nothing.

    Raises:
        CsvError: the file is bad; says line and column.
    """
    content = file.read_bytes() if isinstance(file, Path) else file
    told = progress and (lambda share: progress(READING * share))
    columns, axis, warnings = read_run(content, unit, told)
    if axis != "x":
        return Imported(columns, axis, warnings, None, None, accepted)
    poses = columns[:]
    result = build_result(poses, None, as_applied(accepted))
    issued = None
    if result.scale is not None:
        issued = calibration_content(unit=unit, rig=rig, poses=poses, result=result, accepted=accepted)
    return Imported(columns, axis, warnings, result, issued, accepted)


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
