"""What is made of stored runs: diagnosis, the calibration in force, amendments, noise studies."""
