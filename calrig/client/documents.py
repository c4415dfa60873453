"""What the service answers, typed. What it says beyond these fields is there as it came.

Units are in the names; what is not known is None. A test holds every field to the OpenAPI document.

What a service finds in logs of samples (CONTRACT section 7).
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationError

from calrig.client.errors import Unreachable
from calrig.model.base import Model
from calrig.model.result import Result
from calrig.model.run import AT_REST, Run, Status
from calrig.model.verdict import Verdict

__all__ = ["AT_REST", "Result", "Status", "Verdict"]
"""Of the model; the documents below are this module's own."""


class Document(Model):
    """A part of an answer; it does not change."""

    model_config = ConfigDict(extra="allow")

    @classmethod
    def of(cls, answer: Any) -> Self:
        """An answer, typed.

        Raises:
            Unreachable: it is none of calrig's.
        """
        try:
            return cls.model_validate(answer)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            place = ".".join(map(str, first["loc"]))
            raise Unreachable(
                f"the service answers, and not as calrig does ({place}: {first['msg']})"
            ) from error

    @classmethod
    def each(cls, answer: Any) -> list[Self]:
        """The answers of a list; Unreachable where it is none."""
        if not isinstance(answer, list):
            raise Unreachable("the service answers, and not as calrig does (no list)")
        return [cls.of(one) for one in answer]


class RunRecord(Run, Document):
    """A run as the service has it."""

    plan: dict[str, Any] | None
    verdict: Verdict | None


class RunEvent(Document):
    """Something that happened in a run; `id` counts up from 1 in a run's log.

    `data`: of `state` {"status", "error"}, of `progress` a `Progress`, of `pose` a pose with its `index`, of
    `reading` {"time_s", "stage_deg", "reading_deg", "temperature_c"}.
    """

    id: int
    type: str
    data: dict[str, Any]

    @property
    def is_last(self) -> bool:
        """Whether nobody carries the run out after it; resuming an interrupted one adds others."""
        return self.type == "state" and self.data["status"] in AT_REST


class RigState(Document):
    """A rig and what it is doing."""

    name: str
    stage: str
    imu: str
    simulated: bool
    state: Literal["idle", "busy", "unreachable", "offline"]
    run_id: str | None
    clamp: str | None


class Parameter(Document):
    """A value with its standard error."""

    value: float
    std: float | None


class Effect(Document):
    """Something that a diagnosis found in the residual."""

    name: str
    verdict: Literal["named", "ambiguous", "unnamed"]
    origin: str
    covariate: str
    parameters: dict[str, Parameter | None]
    p_value: float
    confusable_with: list[str]
    evidence: list[str]
    remedy: str


class Errors(Document):
    """RMS of the fit, and of held-out poses."""

    fit_rms_deg: float
    held_out_rms_deg: float | None


class Diagnosis(Document):
    """What the residual of a run was traced to."""

    runs: list[str]
    n_poses: int
    verdict: Literal["named", "ambiguous", "unnamed", "nothing"]
    effects: list[Effect]
    base: Errors
    final: Errors
    follow_up: dict[str, Any] | None
    warnings: list[str]
    says: list[str]


class ComparedRun(Document):
    """The figures of one calibration."""

    run_id: str
    finished_at: datetime
    bias_deg: float
    bias_std_deg: float | None
    scale: float | None
    scale_std: float | None
    rms_calibrated_deg: float | None
    effects: list[str]


class ComparedUnit(Document):
    """A unit's calibrations, the oldest first, and whether it changed by more than repeatability."""

    unit: str
    runs: list[ComparedRun]
    drift_deg_per_day: float | None
    changed: bool
    due_at: datetime | None
    overdue: bool


class Comparison(Document):
    """Units side by side, those first that changed."""

    units: list[ComparedUnit]
    spread: dict[str, Any]


class Revision(Document):
    """A calibration that was issued; `stale` says what has changed since of what it rests on."""

    revision: int
    status: Literal["draft", "in_force", "superseded", "withdrawn"]
    run_id: str
    effects: list[str]
    issued_at: datetime
    reason: str | None
    sha256: str
    verdict: Verdict
    stale: list[str]


class Solution(Document):
    """Stage, mounts and units solved together (CONTRACT section 8), as the service keeps it."""

    id: str
    units: list[dict[str, Any]]
    stage: dict[str, Any]
    mounts: list[dict[str, Any]]
    separable: bool
    before: dict[str, Any]
    final: dict[str, Any]
    warnings: list[str]


class Estimate(Document):
    """A plan on a rig; `wall_s` is the time by the clock on the wall, where the rig's pace is known."""

    n_poses: int
    duration_s: float
    wall_s: float | None
    warnings: list[str]


class Expected(Document):
    """What a plan is expected to come to."""

    duration_s: float
    expanded_uncertainty_deg: float | None
    bias_std_deg: float
    scale_std: float


class PlanDesign(Document):
    """A plan that was designed, ready for `Client.calibrate`, and what it is expected to come to."""

    plan: dict[str, Any]
    expected: Expected
    limit: dict[str, Any] | None
    says: list[str]


class JobState(Document):
    """Long work under way or ended; `result` is the address of what came of it."""

    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    fraction: float | None = Field(description="None where the work cannot say.")
    result: str | None
    error: str | None
    error_status: int | None = None  # services before it was told have none


class Figure(Document):
    """A picture for `plotly.graph_objects.Figure`, and what it shows."""

    caption: str
    figure: dict[str, Any]


class Coefficient(Document):
    """One kind of noise, in the unit given."""

    value: float
    std: float
    unit: str


class NoiseChannel(Document):
    """The noise of a channel; a kind of noise that the log does not ask for is None."""

    mean: float
    std: float
    adf_slope: float | None
    psd_slope: float | None
    colour: str | None
    coefficients: dict[str, Coefficient | None]
    lines: list[dict[str, Any]]


class NoiseReport(Document):
    """CONTRACT section 7."""

    rate_hz: float
    duration_s: float
    channels: dict[str, NoiseChannel]
    summary: list[str]


class NoiseStudy(Document):
    """The noise of a log, and its pictures; `id` where the service keeps it."""

    id: str | None
    report: NoiseReport
    figures: list[Figure]


class FiltersStudy(Document):
    """The filters side by side on a log, as `calrig filters --json` has them; `id` where it is kept."""

    id: str | None
    report: dict[str, Any]
    figures: list[Figure]
