"""A unit's archive: all that stands behind its calibrations, in one file that proves itself years later."""
