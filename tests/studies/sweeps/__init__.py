"""Continuous sweeps on simulated rigs, run after run over their ports: `python -m tests.studies.sweeps`."""
