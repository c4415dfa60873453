"""A plan as a JSON file; a mistake in it is told by file, line and column."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from calrig.plan import Plan

LARGEST = 1_000_000
"""Bytes: ten thousand elevations take a tenth of them."""


class PlanFileError(Exception):
    """The file is not a plan; the message says where and why."""


def read_plan(file: Path) -> Plan:
    """Reads a plan.

    Raises:
        PlanFileError: the file cannot be read, is not JSON, or has an unknown key or a wrong value.
    """
    try:
        with file.open("rb") as opened:
            content = opened.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise PlanFileError(f"{file}: has more than {LARGEST} bytes, which is no plan")
        text = content.decode("utf-8-sig")
        return Plan.model_validate(json.loads(text))
    except OSError as error:
        raise PlanFileError(f"{file}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise PlanFileError(f"{file}: is not UTF-8 text (byte {error.start})") from error
    except json.JSONDecodeError as error:
        raise PlanFileError(f"{file}, line {error.lineno}, column {error.colno}: {error.msg}") from error
    except RecursionError as error:
        raise PlanFileError(f"{file}: is nested too deeply for a plan") from error
    except ValidationError as error:
        problem = error.errors()[0]
        reason = problem["msg"].removeprefix("Value error, ")
        if not problem["loc"]:
            raise PlanFileError(f"{file}: {reason}") from error
        key = str(problem["loc"][0])
        raise PlanFileError(f"{file}{_place_of_key(text, key)}: {key}: {reason}") from error


def _place_of_key(text: str, key: str) -> str:
    """`, line 3, column 5` of a key; those of a plan are not nested, so that the first one found is it."""
    at = text.find(json.dumps(key, ensure_ascii=False))
    if at < 0:
        return ""
    before = text[:at]
    return f", line {before.count(chr(10)) + 1}, column {at - before.rfind(chr(10))}"
