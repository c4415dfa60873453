"""Bodies and answers about joint solutions: CONTRACT section 8."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime
from typing import Annotated, Any

from pydantic import ConfigDict, Field, model_validator

from calrig.api.models import Answer, Body
from calrig.store.solutions import Frame

MOST_NAMED = 2000


class Solve(Body):
    """What to solve together; runs, units or a rig."""

    runs: list[str] = Field(default=[], max_length=MOST_NAMED)
    units: list[str] = Field(
        default=[], max_length=MOST_NAMED, description="All calibrations that count of these units."
    )
    rig: str | None = Field(default=None, description="The rig of the runs; alone, of all of its runs.")
    linear: bool = Field(
        default=False, description="Whether the units are stated to have no quadratic and cubic terms."
    )
    periods_deg: list[Annotated[float, Field(ge=0.5, le=360)]] = Field(
        default=[], max_length=24, description="Known periods of gears, degrees of the dial."
    )

    seat_std_deg: float | None = Field(
        default=None, ge=0, le=90, description="How far one clamping of a face scatters from the next."
    )
    frame: Frame = Field(
        default="sensor",
        description="Of units clamped by several faces, whose their accelerometer's matrix is.",
    )
    limits_deg: tuple[float, float] | None = Field(
        default=None, description="What is advised keeps to them; without, to those of the last run."
    )

    @model_validator(mode="after")
    def _names_something(self) -> "Solve":
        if not (self.runs or self.units or self.rig):
            raise ValueError("name runs, units or a rig: there is nothing to solve")
        return self


class Joint(Answer):
    """A part of the document, kept as it was found: one that a later calrig found may have more in it."""

    model_config = ConfigDict(extra="allow", json_schema_serialization_defaults_required=True)


class Value(Joint):
    """A parameter with its standard error, null where it is not known."""

    value: float | None
    std: float | None


class ElevationStd(Joint):
    """The standard error of a calibrated elevation, by elevation."""

    elevation_deg: list[float]
    std_deg: list[float]


class SolvedUnit(Joint):
    """A unit's parameters, and what its elevations are worth over its range."""

    unit: str
    parameters: dict[str, Value]
    accelerometer: dict[str, Any] | None
    gyro: dict[str, Any] | None
    range_deg: list[float]
    elevation_std_deg: ElevationStd


class StageMap(Joint):
    """The stage's error over its dial, less its mean, as in the middle of the play."""

    stage_deg: list[float]
    error_deg: list[float]
    std_deg: list[float]


class Harmonic(Joint):
    """amplitude·sin(order·dial + phase); `separable` where it is known better than one pose is measured."""

    order: float
    amplitude_deg: float
    phase_deg: float
    std_deg: float
    separable: bool


class Stage(Joint):
    """What the stage does wrong."""

    map: StageMap
    harmonics: list[Harmonic]
    backlash_deg: Value | None


class SolvedMount(Joint):
    """A clamping: the angle that was stated, and the one that was found."""

    mount: str
    unit: str
    mount_deg: float
    angle_deg: Value


class Advice(Joint):
    """Mounts that would help, and what an elevation is worth now and would be then."""

    mounts_deg: list[float]
    elevation_std_deg_now: float
    elevation_std_deg_then: float
    says: str


class HeldOutRms(Joint):
    """RMS of what was held out."""

    held_out_rms_deg: float | None


class _Kept(Answer):
    """What every solution is known by."""

    id: str
    created_at: datetime
    by: str | None
    rig: str | None
    runs: list[str]
    linear: bool
    periods_deg: list[float]
    seat_std_deg: float | None
    frame: Frame


class ListedSolution(_Kept):
    """A solution in a list; `units` are serials."""

    units: list[str]
    separable: bool
    before: HeldOutRms
    final: HeldOutRms


class SolutionAnswer(_Kept, Joint):
    """CONTRACT section 8, and what it rests on."""

    units: list[SolvedUnit]
    stage: Stage
    mounts: list[SolvedMount]
    separable: bool
    advice: Advice | None
    held_out: dict[str, Any]
    before: HeldOutRms
    final: HeldOutRms
    noise: dict[str, float]
    level_known: bool
    level_std_deg: float | None
    warnings: list[str]


class PosesLeft(Answer):
    """Columns of poses: index of the mount, dial, map with what is left, what is left before and after."""

    mount: list[int]
    dial_deg: list[float]
    on_map_deg: list[float]
    before_deg: list[float]
    left_deg: list[float]
