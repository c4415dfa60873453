"""What leaves and enters as text: poses and samples as CSV, a unit's calibration as JSON."""
