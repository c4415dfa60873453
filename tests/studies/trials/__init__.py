"""What calrig must withstand, tried and counted: `python -m tests.studies.trials` makes the whole table."""

import logging

logging.getLogger("calrig").addHandler(logging.NullHandler())  # runs that fail are what is tried here
