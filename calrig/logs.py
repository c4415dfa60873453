"""The log: one line an event, as text for people or as JSON for programs, each with the run it is about."""

import json
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any, Literal, TextIO

from calrig.errors import InputError

Format = Literal["text", "json"]
FORMATS: tuple[Format, ...] = ("text", "json")

_about: ContextVar[Mapping[str, Any]] = ContextVar("calrig_log_about", default={})  # noqa: B039 (never changed)
_FORGING = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
"""What could end a line, colour a terminal, or cannot be written."""


@contextmanager
def about(**fields: Any) -> Iterator[None]:
    """Add fields (run_id, rig, unit) to every line that this thread or task logs inside the block."""
    before = _about.set({**_about.get(), **fields})
    try:
        yield
    finally:
        _about.reset(before)


def configure_log(named: str | None) -> None:
    """Sends the log to standard error in the format named, else in CALRIG_LOG's, else as text.

    Raises:
        InputError: there is no such format.
    """
    wanted = named or os.environ.get("CALRIG_LOG") or "text"
    for known in FORMATS:
        if known == wanted:
            configure(known)
            return
    raise InputError(f"--log-format or CALRIG_LOG: there is no log format {wanted!r}: text or json")


def configure(format_: Format, stream: TextIO | None = None) -> None:
    """Sends every log of the process to a stream, standard error where none is named, in one format."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.addFilter(_note_what_it_is_about)
    handler.setFormatter(JsonLines() if format_ == "json" else TextLines())
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("calrig").setLevel(logging.INFO)
    logging.captureWarnings(True)


def _note_what_it_is_about(record: logging.LogRecord) -> bool:
    """A filter: runs in the thread that logs, where the context is known."""
    record.about = {**_about.get(), **getattr(record, "fields", {})}
    return True


class JsonLines(logging.Formatter):
    """`{"time":…, "level":…, "logger":…, "message":…, "run_id":…}`; a traceback is one more string."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as one line."""
        line = {
            "time": _time(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **getattr(record, "about", {}),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)  # ASCII: nothing in it ends a line


class TextLines(logging.Formatter):
    """`2026-11-21T19:03:57.123Z warning calrig.runs.worker: message [run_id=17 rig=bench-1]`.

    What devices and people wrote cannot begin a line: control characters are escaped, and the lines of a
    traceback are set in.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The record as one line, and a line more for each of its traceback."""
        known = " ".join(f"{name}={value}" for name, value in getattr(record, "about", {}).items())
        message = f"{record.getMessage()}{f' [{known}]' if known else ''}"
        line = f"{_time(record)} {record.levelname.lower()} {record.name}: {escaped(message)}"
        if record.exc_info:
            traceback = self.formatException(record.exc_info).split("\n")
            line = "\n".join([line, *(f"  | {escaped(one)}" for one in traceback)])
        return line


def escaped(text: str) -> str:
    r"""Text on one line: control characters as `\n`, `\x1b` or `\u2028`."""
    return _FORGING.sub(lambda found: ascii(found[0])[1:-1], text)


def _time(record: logging.LogRecord) -> str:
    at = datetime.fromtimestamp(record.created, UTC)
    return at.isoformat(timespec="milliseconds").replace("+00:00", "Z")
