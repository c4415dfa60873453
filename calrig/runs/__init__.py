"""Carry out a plan on a rig: states, moves, dwells, safe stop, event log."""
