"""Where the program begins: a Ctrl-C while it is still being loaded ends it in one line, too."""

import sys


def main() -> None:
    """Loads the commands and carries out what was typed."""
    try:
        from calrig.cli.main import main as carry_out
    except KeyboardInterrupt:
        sys.exit("calrig: interrupted")
    carry_out()
