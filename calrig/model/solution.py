"""A joint solution of stage, mounts and units (CONTRACT section 8)."""

from datetime import datetime
from typing import Any, Literal

from pydantic import ConfigDict

from calrig.model.base import Model

Frame = Literal["sensor", "faces"]
"""Whose the accelerometer's matrix is, of units clamped by several faces."""


class _Part(Model):
    """A part of the document as it was stored: one that a later calrig wrote may have more fields."""

    model_config = ConfigDict(extra="allow", json_schema_extra={"additionalProperties": True})


class SolvedValue(_Part):
    """A parameter with its standard error, null where it is not known."""

    value: float | None
    std: float | None


class ElevationStd(_Part):
    """Standard error of a calibrated elevation, by elevation."""

    elevation_deg: list[float]
    std_deg: list[float]


class SolvedUnit(_Part):
    """A unit's parameters, and the standard error of its elevations over its range."""

    unit: str
    parameters: dict[str, SolvedValue]
    accelerometer: dict[str, Any] | None
    gyro: dict[str, Any] | None
    range_deg: list[float]
    elevation_std_deg: ElevationStd


class MapColumns(_Part):
    """The stage's error over its dial, less its mean, in mid-backlash; null where it is not determined."""

    stage_deg: list[float]
    error_deg: list[float | None]
    std_deg: list[float | None]


class Harmonic(_Part):
    """amplitude·sin(order·dial + phase); `separable` where its error is below that of one pose."""

    order: float
    amplitude_deg: float
    phase_deg: float
    std_deg: float
    separable: bool


class StageErrors(_Part):
    """The errors of the stage."""

    map: MapColumns
    harmonics: list[Harmonic]
    backlash_deg: SolvedValue | None


class SolvedMount(_Part):
    """A clamping: the angle that was stated, and the one that was estimated."""

    mount: str
    unit: str
    mount_deg: float
    angle_deg: SolvedValue


class MountAdvice(_Part):
    """Additional mounts that would help, with the standard error of an elevation now and then."""

    mounts_deg: list[float]
    elevation_std_deg_now: float
    elevation_std_deg_then: float
    says: str


class HeldOutRms(_Part):
    """RMS error on held-out poses."""

    held_out_rms_deg: float | None


class SolutionDocument(_Part):
    """CONTRACT section 8."""

    units: list[SolvedUnit]
    stage: StageErrors
    mounts: list[SolvedMount]
    separable: bool
    advice: MountAdvice | None
    held_out: dict[str, Any]
    before: HeldOutRms
    final: HeldOutRms
    noise: dict[str, float]
    level_known: bool
    level_std_deg: float | None
    warnings: list[str]


class SolutionBasis(Model):
    """The id of a stored solution, and what it was computed from."""

    id: str
    created_at: datetime
    by: str | None
    rig: str | None
    runs: list[str]
    linear: bool
    periods_deg: list[float]
    seat_std_deg: float | None
    frame: Frame


class ListedSolution(SolutionBasis):
    """A solution in a list; `units` are serial numbers."""

    units: list[str]
    separable: bool
    before: HeldOutRms
    final: HeldOutRms


class Solution(SolutionBasis, SolutionDocument):
    """CONTRACT section 8, and what it was computed from."""

    model_config = SolutionDocument.model_config


class PoseResiduals(Model):
    """Columns of poses: index of the mount, dial, map plus residual, residual before and after."""

    mount: list[int]
    dial_deg: list[float]
    on_map_deg: list[float]
    before_deg: list[float]
    left_deg: list[float]


class ErrorMap(Model):
    """Mean error of a rig: elevation less dial, by the dial's angle and approach, and the number of units.

    Empty where it cannot be computed yet; `says` tells what would help, or what it was computed from.
    """

    stage_deg: list[float]
    approach: list[int]
    error_deg: list[float]
    std_deg: list[float]
    units: int
    says: str
