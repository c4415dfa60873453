"""Carry out a plan, procedure by procedure: dwell, continuous, static."""
