"""A file that is too large is refused before it is read."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from command_line import reason

LARGE, ROOM = 2_000_000_000, 1_000_000_000
"""Bytes: of the file, and what is left to the process."""


@pytest.fixture
def little_memory():
    """The process cannot have the room that reading such a file would take."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.mark.parametrize(
    "command",
    [
        ("import", "large.csv", "--unit", "A"),
        ("diagnose", "large.csv"),
        ("gravity", "large.csv"),
        ("noise", "large.csv"),
        ("run", "--unit", "A", "--plan", "large.csv"),
    ],
    ids=lambda command: command[0],
)
def test_a_file_of_two_gigabytes_is_not_read(folder, little_memory, command):
    with (folder / "large.csv").open("wb") as opened:
        opened.write(b"target_deg,reading_deg,accel_x_g\n1,2,3\n")
        opened.truncate(LARGE)  # sparse: it takes no room
    assert "large.csv: has more than" in reason(*command, status=2)
