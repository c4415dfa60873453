"""The documents of a joint solution as files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any


def joint_files(calibrations: Mapping[str, dict[str, Any]], stage_map: dict[str, Any]) -> dict[str, str]:
    """The files' texts by their names; those of a unit's serial, with what no file is called by replaced.

    Args:
        calibrations: `unit_document` of each unit, by serial.
        stage_map: `map_document`.
    """
    named = {_file_name(serial): document for serial, document in calibrations.items()}
    return {name: in_file(document) for name, document in {**named, "stage-map.json": stage_map}.items()}


def in_file(document: dict[str, Any]) -> str:
    """A document as its file has it."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _file_name(serial: str) -> str:
    return re.sub(r"[^\w.\-]", "_", serial).lstrip(".") + ".json"
