"""A calibration in the formats of other programs, with a test vector by that program's own arithmetic."""
