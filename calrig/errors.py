"""What the command line says in one line, by the exit status that it leaves with."""

from __future__ import annotations


class WorkError(Exception):
    """The work failed (1); the message is the reason."""


class InputError(Exception):
    """Wrong usage or unreadable input (2); the message says where."""


def printable(text: str) -> str:
    """Text from outside that goes to a terminal: what would move the cursor or turn the writing is shown.

    Serial numbers, names of files and ports, and what devices say may hold anything.
    """
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)
