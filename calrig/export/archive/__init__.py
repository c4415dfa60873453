"""A unit's archive: everything behind its calibrations, in one file that can be verified years later."""
