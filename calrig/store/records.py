"""Records that the store returns and accepts. They do not depend on the tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, Literal, NamedTuple, NotRequired, TypedDict

import numpy as np

import calrig.model.run
from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.results import AppliedEffect, EffectDoubt, numbers_of, own_effect
from calrig.calibration.separation import StageMap
from calrig.calibration.uncertainty import make_verdict
from calrig.estimation.angles import FloatArray
from calrig.estimation.kalman import KalmanNoise
from calrig.model.result import Reference, Result
from calrig.model.run import Progress, Status
from calrig.model.solution import Frame
from calrig.model.verdict import Limit, Verdict

Document = dict[str, Any]
"""A JSON object."""


class Run(calrig.model.run.Run):
    """A run as stored, with its plan and the limit that its verdict follows from; times are aware and in UTC.

    It is read without validation, so that a run with an old or damaged document stays readable.
    """

    plan: Document | None
    limit: Limit | None = None
    """Matches its unit and rig now; None without a result."""

    @property
    def kind(self) -> str:
        """The kind of its plan; an import, which has none, is a calibration."""
        return str((self.plan or {}).get("kind", "calibration"))

    @property
    def verdict(self) -> Verdict | None:
        """Whether its result is good, after everything accepted; None while there is no result."""
        if self.result is None:
            return None
        how = how_judged(self.plan, self.faults)
        return make_verdict(self.result, self.diagnosis, limit=self.limit, **how)


class HowJudged(TypedDict):
    """What a verdict follows from beside result, diagnosis and limit."""

    verification: bool
    move_mismatches: int


def how_judged(plan: Document | None, faults: Mapping[str, int]) -> HowJudged:
    """The same of a run with this plan and these faults."""
    return {
        "verification": (plan or {}).get("kind") == "verification",
        "move_mismatches": faults.get("move_mismatch", 0),
    }


def reference_of(provenance: Document) -> Reference | None:
    """What the rig said of its stage when a run was made; None where it said nothing, or none was known."""
    stated = (provenance.get("rig") or {}).get("reference")
    if stated is None or stated["std_deg"] is None:  # a map alone, and no certificate
        return None
    usual = Reference(stated["std_deg"])
    return replace(usual, **{key: stated[key] for key in ("kind", "distribution") if key in stated})


def map_of(provenance: Document) -> StageMap | None:
    """The stage's map that was in force when a run was made; None where there was none."""
    kept = provenance.get("stage_map")
    return None if kept is None else StageMap.from_frozen(kept)


def filtering_of(provenance: Document, plan: Document | None) -> Filtering | None:
    """The filter that a run's readings went through; None where nothing is known of it."""
    stated, board, planned = provenance.get("filter"), provenance.get("board") or {}, plan or {}
    if stated is None:
        return None
    usual = Filtering()
    rate_hz = board.get("rate_hz") or planned.get("rate_hz", usual.rate_hz)
    return Filtering(
        KalmanNoise(**stated),
        float(rate_hz),
        float(planned.get("dwell_s", usual.dwell_s)),
        remembers=planned.get("kind") != "sweep",
        **_motion_of(provenance, planned),
    )


def _motion_of(provenance: Document, planned: Document) -> dict[str, float]:
    """Velocity and acceleration of the elevation, by controller and plan; nothing where one is not known."""
    stage, configured = provenance.get("stage") or {}, (provenance.get("rig") or {}).get("stage") or {}
    ratio = abs(configured.get("ratio") or 1.0)
    velocity, acceleration = stage.get("velocity_dps"), stage.get("acceleration_dps2")
    velocity_dps = planned.get("velocity_dps") or (velocity and velocity / ratio)
    if not velocity_dps or not acceleration:
        return {}
    return {"velocity_dps": float(velocity_dps), "acceleration_dps2": float(acceleration / ratio)}


class RunColumns(TypedDict):
    """What a new run is told of itself; None and left out say that nobody knows, or that it is not so.

    `follows` is the id of the run that it is a follow-up of.
    """

    unit: str
    plan: Document | None
    operator: NotRequired[str | None]
    note: NotRequired[str | None]
    follows: NotRequired[str | None]
    provenance: Document


class RunChanges(TypedDict, total=False):
    """What `Runs.update` can change."""

    status: Status
    error: str | None
    progress: Progress
    result: Result | None
    diagnosis: Document | None
    faults: dict[str, int]
    provenance: Document
    plan: Document | None


@dataclass(frozen=True, slots=True)
class Event:
    """Something that was announced: `seq` counts from 1 within a run, without gaps."""

    seq: int
    type: str
    data: Document


@dataclass(frozen=True, slots=True)
class StoredPose:
    """A pose of a run; `excluded` is the reason why it does not count, else None."""

    index: int
    pose: Pose
    excluded: str | None


@dataclass(frozen=True, slots=True)
class StoredStagePosition:
    """Where a stage was left, in its own degrees, and when; None: on its way, and nobody knows where."""

    stage_deg: float | None
    at: datetime


@dataclass(frozen=True, slots=True)
class AcceptedEffect:
    """An effect that a person accepted, of a unit or of a rig (the other is None), and the run it is from.

    `parameters` are CONTRACT section 5's by name, numbers or null; `id` is the store's, of one that it gave.
    Older stores lack the other fields.

    Attributes:
        runs: ids of the runs whose poses the parameters were fitted to.
        std: standard errors of the parameters, where they are known.
        factor: of each parameter a row of the triangular matrix L that has the covariance L·Lᵀ of all effects
            accepted until then, in their order; none where that is not known.
        run_offset_std_deg: standard deviation between days and clampings; None where it was not fitted.
        is_joint: the parameters are those of one model of all acceptances of the unit, fitted by calrig, not
            those of the diagnosis that was accepted.
        is_partial: effects of other runs had been taken out of the poses when the parameters were found, so
            that they mean nothing without a joint fit.
    """

    run_id: str
    unit: str | None
    rig: str | None
    name: str
    origin: str
    parameters: dict[str, float | None]
    id: int | None = field(default=None, compare=False)
    runs: Sequence[str] = ()
    std: Mapping[str, float] = field(default_factory=dict)
    factor: Mapping[str, Sequence[float]] = field(default_factory=dict)
    run_offset_std_deg: float | None = None
    is_joint: bool = False
    is_partial: bool = False

    @property
    def rests_on(self) -> list[str]:
        """Ids of the runs whose poses its parameters were fitted to."""
        return list(self.runs) or [self.run_id]


def as_applied(accepted: Sequence[AcceptedEffect]) -> list[AppliedEffect]:
    """Accepted effects as arithmetic takes them."""
    return [
        own_effect(effect.name, effect.parameters)
        if effect.unit is not None
        else (effect.name, numbers_of(effect.parameters))
        for effect in accepted
    ]


def doubt_of(accepted: Sequence[AcceptedEffect], run_id: str | None = None) -> EffectDoubt:
    """How well accepted effects are known, in their order; nothing is known of it in older acceptances.

    `run_id` is that of the run they are taken out of; None if none of them can rest on it.
    """
    offsets_deg = [one.run_offset_std_deg or 0.0 for one in accepted]
    fitted_here = sum(len(one.std) for one in accepted if run_id is not None and run_id in one.rests_on)
    stds, factors = [one.std for one in accepted], [one.factor for one in accepted]
    return EffectDoubt(stds, max(offsets_deg, default=0.0), fitted_here, factors)


@dataclass(frozen=True, slots=True)
class Size:
    """What the store takes, and what room is left on its disk; None where that is another machine's."""

    used_bytes: int
    free_bytes: int | None


@dataclass(frozen=True, slots=True)
class Unit:
    """A sensor being calibrated, and how often and when it was last on a rig."""

    serial: str
    created_at: datetime
    n_runs: int
    last_run_at: datetime | None


class ComparisonRow(NamedTuple):
    """One completed, not voided calibration of one unit; a tuple, for there are thousands.

    `result` holds the figures of the run's result that `tables.CalibrationTable` has, named as there.
    """

    unit: str
    run_id: str
    rig: str | None
    finished_at: datetime
    result: Document


@dataclass(frozen=True, slots=True)
class RawSamples:
    """n raw samples in the order taken, as `calrig.instruments.types.Samples` has them.

    Attributes:
        angle_deg: (n,) elevation as the board computed it; None where it sends what it measured.
    """

    time_s: FloatArray
    accel_g: FloatArray
    gyro_dps: FloatArray
    temperature_c: FloatArray
    angle_deg: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """The raw samples of the move into a pose, or of its dwell; arrays as in `RawSamples`.

    Raises:
        ValueError: the arrays are not of one length or not of the shapes stated.
    """

    pose_index: int
    phase: Literal["move", "dwell"]
    time_s: FloatArray
    accel_g: FloatArray
    gyro_dps: FloatArray
    temperature_c: FloatArray
    angle_deg: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.time_s)
        shapes = {"time_s": (n,), "accel_g": (n, 3), "gyro_dps": (n, 3), "temperature_c": (n,)}
        if self.angle_deg is not None:
            shapes["angle_deg"] = (n,)
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}, not {shape}")


@dataclass(frozen=True, slots=True)
class Basis:
    """What a joint solution rests on.

    Attributes:
        runs: ids of the runs, all of one rig.
        linear: whether the units were stated to have no quadratic and cubic terms.
        periods_deg: of gears that somebody knew.
        seat_std_deg: how far one clamping was said to scatter from the next; None where nobody did.
        frame: of units clamped by several faces, whose their matrix is.
    """

    runs: tuple[str, ...]
    units: tuple[str, ...]
    linear: bool = False
    periods_deg: tuple[float, ...] = ()
    seat_std_deg: float | None = None
    frame: Frame = "sensor"


@dataclass(frozen=True, slots=True)
class Solved:
    """A joint solution as it leaves the arithmetic, before it has an id.

    Attributes:
        rig: whose stage it is of; None where the runs name none.
        document: CONTRACT section 8.
        calibrations: CONTRACT section 6 by serial, with the uncertainty of this solution.
        stage_map: what `stage-map.json` has.
        poses: equally long columns for the picture (`calrig.figures.joint`).
    """

    rig: str | None
    basis: Basis
    document: Document
    calibrations: dict[str, Document]
    stage_map: Document
    poses: Document

    @property
    def is_whole(self) -> bool:
        """Whether the units were clamped by several faces."""
        return any(mount["mount_axis"][-1] != "x" for mount in self.document["mounts"])
