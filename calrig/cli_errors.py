"""What the command line says in one line, by the exit status that it leaves with."""

from __future__ import annotations


class WorkError(Exception):
    """The work failed (1); the message is the reason."""


class InputError(Exception):
    """Wrong usage or unreadable input (2); the message says where."""
