"""Designed plans against the fixed one, on the simulator's physics: `python -m tests.studies.plans`."""
