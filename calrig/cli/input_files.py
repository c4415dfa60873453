"""Files that commands read: bounded, and refused in one line that names file, line and column."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from calrig.cli.options import looks_like_an_id
from calrig.errors import InputError, readable

if TYPE_CHECKING:
    from calrig.calibration.poses import Pose
    from calrig.export.static_csv import StaticLog
    from calrig.model.plan import Plan

LARGEST_LOG = 1_500_000_000
"""Bytes; more than a day at 200 Hz."""
LARGEST_POSES = 150_000_000
LARGEST_PLAN = 1_000_000
"""Bytes: ten thousand elevations take a tenth of them."""


def names_a_file(source: str) -> bool:
    """A file or, of what could be no run's id, a wrong name of one, so that it is said to be that."""
    return not looks_like_an_id(source) or Path(source).is_file()


def in_utf8(name: str) -> str:
    """A file's name with the bytes shown that are no UTF-8; only the system can do with them as they are."""
    return name.encode("utf-8", "backslashreplace").decode()


def read_bytes(file: Path, limit: int = LARGEST_POSES) -> bytes:
    """The file's content, or InputError that says why not; a file that says its size is not read in vain."""
    with readable(file), file.open("rb") as opened:
        is_larger = os.fstat(opened.fileno()).st_size > limit
        content = b"" if is_larger else opened.read(limit + 1)
    if is_larger or len(content) > limit:
        raise InputError(f"{file}: larger than the maximum of {limit} bytes; split the file")
    return content


@contextmanager
def told_of(file: object, *kinds: type[Exception]) -> Iterator[None]:
    """Errors of these kinds in the block are InputErrors that name the file."""
    try:
        yield
    except kinds as error:
        raise InputError(f"{file}: {error}") from error


def read_poses_file(file: Path) -> tuple[list[Pose], list[str]]:
    """Poses of one unit about its x, to be diagnosed, and what is to be said of them."""
    from calrig.export.csv_errors import CsvError
    from calrig.export.poses_csv import read_about_x

    with told_of(file, CsvError):
        return read_about_x(read_bytes(file))


def read_log_file(
    file: Path,
    accel_range_g: int | None,
    gyro_range_dps: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> StaticLog:
    """A log of samples; `progress` is told the share that is read, 0 to 1."""
    from calrig.export.csv_errors import CsvError
    from calrig.export.static_csv import read_static

    with told_of(file, CsvError):
        return read_static(
            read_bytes(file, LARGEST_LOG),
            accel_range_g=accel_range_g,
            gyro_range_dps=gyro_range_dps,
            progress=progress,
        )


def read_plan_file(file: Path) -> Plan:
    """A plan as JSON, or what `calrig plan --json` says of one; a mistake is told by line and column."""
    from pydantic import ValidationError

    from calrig.canonical_json import json_of_file
    from calrig.invalid_fields import path_of, reason
    from calrig.model.plan import Plan

    content = read_bytes(file, LARGEST_PLAN)
    document = json_of_file(content, str(file), "a plan")
    is_design = isinstance(document, dict) and {"plan", "expected"} <= document.keys()
    try:
        return Plan.model_validate(document["plan"] if is_design else document)
    except ValidationError as error:
        problem = error.errors()[0]
        if not problem["loc"]:
            raise InputError(f"{file}: {reason(problem)}") from error
        where = _place_of_key(content.decode("utf-8-sig"), str(problem["loc"][0]))
        raise InputError(f"{file}{where}: {path_of(problem)} {reason(problem)}") from error


def _place_of_key(text: str, key: str) -> str:
    """`, line 3, column 5` of a key; those of a plan are not nested, so that the first one found is it."""
    at = text.find(json.dumps(key, ensure_ascii=False))
    if at < 0:
        return ""
    before = text[:at]
    return f", line {before.count(chr(10)) + 1}, column {at - before.rfind(chr(10))}"
