"""The errors of poses that a certificate shows: by elevation, and pose by pose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Point:
    """The errors about one elevation, degrees: mean over its poses, and from lowest to highest.

    Attributes:
        found_deg: before: by the calibration that was in force, or as the unit read.
        left_deg: with this calibration.
        expanded_deg: expanded uncertainty of the calibrated elevation; None where it is not known.
    """

    elevation_deg: float
    n_poses: int
    found_deg: float
    found_low_deg: float
    found_high_deg: float
    left_deg: float
    left_low_deg: float
    left_high_deg: float
    expanded_deg: float | None


@dataclass(frozen=True, slots=True)
class Step:
    """What is left of each pose after something was taken out, degrees, in the order of the poses."""

    title: str
    left_deg: tuple[float, ...]
    rms_deg: float


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is left of each pose, step by step: as it came, by bias and scale, then effect by effect."""

    elevation_deg: tuple[float, ...]
    approach: tuple[int, ...]
    steps: tuple[Step, ...]
