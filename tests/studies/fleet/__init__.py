"""Fleets of simulated runs, and what screening them takes: `python -m tests.studies.fleet DIR`."""
