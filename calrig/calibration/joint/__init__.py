"""Stage map, mounts and units solved together (CONTRACT section 8): one least squares over gravity's vectors.

Elevation of a unit = dial angle + map(dial angle, approach) + angle of its mount. Harmonic k of the map turns
with the dial, the unit's errors with the mount, so that units clamped at several angles part the two (circle
closure: Estler, J. Res. NIST 103, 1998); |a| = 1 g sees the unit and never the stage.
"""
