"""A certificate as a Digital Calibration Certificate: PTB's XML, schema 3.2.1 with D-SI 2.1.0."""
