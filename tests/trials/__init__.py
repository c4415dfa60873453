"""What calrig must withstand, tried and counted: `python -m tests.trials` makes the whole table."""
