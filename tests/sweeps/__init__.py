"""What sweeps are worth on simulated rigs, run after run over their ports: `python -m tests.sweeps`."""
