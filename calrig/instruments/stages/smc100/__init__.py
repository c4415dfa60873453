"""Newport SMC100."""
