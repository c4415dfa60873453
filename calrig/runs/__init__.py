"""Carrying a plan out on a rig: states, moves, dwells, safe stop, the event log."""
