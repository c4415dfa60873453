"""The command line as a person or script uses it, in this process."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from typer import testing
from typer.testing import CliRunner, Result

from calrig.cli.main import app

# The tree of all commands is made once: made anew for each, it takes longer than most of them do.
testing._get_command = cache(testing._get_command)

RIG = """
[[rig]]
name = "bench-1"
stage = { driver = "smc100", port = "/dev/ttyABSENT0" }
imu = { driver = "calrig", port = "/dev/ttyABSENT1" }
"""
"""A rig that is not plugged in."""
POSES = "target_deg,reading_deg\n-30,-29.5\n0,0.4\n30,30.6\n"


def calrig(*arguments: Any, status: int = 0) -> Result:
    """Runs a command to its end; whatever a user does, there is an exit status and never a traceback."""
    with log_put_back():
        done = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == status, done.output
    return done


def reason(*arguments: Any, status: int) -> str:
    """The one line on standard error with which a command fails."""
    done = calrig(*arguments, status=status)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("calrig: ")
    return line


@contextmanager
def log_put_back() -> Iterator[None]:
    """Undo what `serve` and `agent` do to the log of their whole process."""
    root, ours = logging.getLogger(), logging.getLogger("calrig")
    before = root.handlers, root.level, ours.level
    try:
        yield
    finally:
        root.handlers, root.level, ours.level = before
        logging.captureWarnings(False)
