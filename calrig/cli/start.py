"""Where the program begins: a Ctrl-C while it is still being loaded ends it in one line, too."""

import gc
import sys

OBJECTS_BETWEEN_LOOKS = gc.get_threshold()
"""Of the garbage collector, as Python has it."""
WHILE_LOADING = 100_000
"""What is imported stays: to look for garbage in it again and again is a sixth of a start."""


def main() -> None:
    """Loads the commands and carries out what was typed."""
    gc.set_threshold(WHILE_LOADING)
    try:
        from calrig.cli.main import main as carry_out
    except KeyboardInterrupt:
        sys.exit("calrig: interrupted")
    carry_out()


def loaded() -> None:
    """Tells the garbage collector, in a command that goes on for long, that what is there stays."""
    gc.freeze()
    gc.set_threshold(*OBJECTS_BETWEEN_LOOKS)
