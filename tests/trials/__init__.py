"""What calrig must withstand, tried and counted: `python -m tests.trials` makes the whole table."""

import logging
import sys
from pathlib import Path

logging.getLogger("calrig").addHandler(logging.NullHandler())  # runs that fail are what is tried here
sys.path.insert(0, str(Path(__file__).parent.parent))  # as pytest does for what tests share
