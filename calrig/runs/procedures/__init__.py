"""Carry out a plan by one of three procedures: dwell, continuous, static."""
