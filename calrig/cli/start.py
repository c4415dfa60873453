"""Where the program begins: a Ctrl-C while it is still being loaded ends it in one line, too."""

import gc
import os
import sys
from pathlib import Path

from calrig.processes.threads import have_one_thread

OBJECTS_BETWEEN_LOOKS = gc.get_threshold()
"""Of the garbage collector, as Python has it."""
WHILE_LOADING = 100_000
"""What is imported stays: to look for garbage in it again and again is a sixth of a start."""


def main() -> None:
    """Loads the commands and carries out what was typed."""
    gc.set_threshold(WHILE_LOADING)
    have_one_thread()
    _have_outputs()
    try:
        from calrig.cli.main import main as carry_out
    except KeyboardInterrupt:
        sys.exit("calrig: interrupted")
    carry_out()


def _have_outputs() -> None:
    """Has what the shell has closed (`>&-`) take everything, so that no command asks whether it is there."""
    nowhere = Path(os.devnull)
    sys.stdout = sys.stdout or nowhere.open("w", encoding="utf-8")
    sys.stderr = sys.stderr or nowhere.open("w", encoding="utf-8")


def loaded() -> None:
    """Tells the garbage collector, in a command that goes on for long, that what is there stays."""
    gc.freeze()
    gc.set_threshold(*OBJECTS_BETWEEN_LOOKS)
