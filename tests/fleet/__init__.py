"""Fleets of runs from the simulator's physics, and what screening them takes: `python -m tests.fleet DIR`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # where pytest finds `blind` too
