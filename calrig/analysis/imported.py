"""Poses of a file and what a line through them is: read and fitted without a store, in any process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calrig.calibration.result import AppliedEffect, build_result
from calrig.export.poses_csv import PoseColumns, read_pose_columns


@dataclass(frozen=True, slots=True)
class Imported:
    """What a run is made of: the poses, what was said of the file, and CONTRACT section 2's result."""

    poses: PoseColumns
    warnings: list[str]
    result: dict[str, Any]


def read_and_fit(content: bytes | Path, effects: Sequence[AppliedEffect]) -> Imported:
    """Reads a CSV of poses (CONTRACT section 4) and fits them.

    Args:
        content: the file, or its path.
        effects: in force for its unit and rig.

    Raises:
        CsvError: the file is bad; says line and column.
    """
    poses, warnings = read_pose_columns(content.read_bytes() if isinstance(content, Path) else content)
    return Imported(poses, warnings, build_result(poses[:], None, effects).to_dict())
