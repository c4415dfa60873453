"""A diagnosis (CONTRACT section 5): the effects that the residual of a run was traced to, and the errors."""

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from calrig.model.base import Model

EffectVerdict = Literal["named", "ambiguous", "unnamed"]
Origin = Literal["sensor", "stage", "mounting", "process", "environment", "unknown"]
"""What an effect belongs to."""


class Parameter(Model):
    """A parameter with its standard error, null where it was found by scanning."""

    value: float
    std: float | None


class Considered(Model):
    """A candidate, its distance to the best in −2 log likelihood with penalties, and why it was rejected."""

    name: str
    behind: float
    why: str | None = None  # null in diagnoses stored before it was kept


class ChangedBetween(Model):
    """The two runs between which an effect changed; its parameters are the later less the earlier values."""

    from_: str = Field(alias="from")
    to: str


class EffectFound(Model):
    """A selected effect; `accepted_at` is null until a person accepts it."""

    name: str
    verdict: EffectVerdict
    origin: Origin
    covariate: str
    parameters: dict[str, Parameter | None]
    corrects: Literal["unit", "rig"] | None = Field(
        default=None,
        description="Whose readings it corrects once accepted; null if it cannot be, and in older ones.",
    )
    explained: float | None = Field(
        default=None,
        description=(
            "Share of the mean square residual of bias and scale that the effect explains in the final fit: "
            "its covariance with that residual over the residual's mean square. The shares and that of the "
            "final residual add up to 1; null in older diagnoses."
        ),
    )
    p_value: float
    changed: ChangedBetween | None = None  # null: the effect is the same in all runs
    confusable_with: list[str]
    evidence: list[str]
    remedy: str
    considered: list[Considered]
    least_p_value: float | None = None  # resolution of the bootstrap; null in older diagnoses
    accepted_at: datetime | None = None  # null in diagnoses stored before it was kept


class HeldOut(Model):
    """How the errors on held-out poses were measured."""

    how: str
    n_poses: int


class LackOfFit(Model):
    """Variance ratio of residual and pure error, with the degrees of freedom of both."""

    f: float
    freedom: tuple[float, float]
    p_value: float
    rejected: bool


class ReadingNoise(Model):
    """Residual of the reading under the final model, and the pure error that it is compared with.

    `floor_deg` is the standard error of a reading from within the dwells, `repeat_deg` the scatter of poses
    revisited from the same direction, slow changes included; `pure_error_deg` is of both, without these.
    """

    std_deg: float
    lag1_correlation: float
    floor_deg: float | None
    repeat_deg: float | None = None  # the last three are null in diagnoses stored before they were kept
    pure_error_deg: float | None = None
    lack_of_fit: LackOfFit | None = None


class Errors(Model):
    """RMS error of a fit, on held-out poses between the others, and on contiguous blocks of poses."""

    fit_rms_deg: float | None  # null of a line that does not follow the stage
    held_out_rms_deg: float | None
    blocked_rms_deg: float | None = None  # null in diagnoses stored before it was measured


class BaseErrors(Errors):
    """Errors with bias and scale alone."""

    bias_deg: float
    scale: float | None


class FinalErrors(Errors):
    """Errors with the selected effects; the blocks are those, of time or angle, that improve least."""

    model: str


class FollowUp(Model):
    """A run expected to separate the competing effects; `separation` in −2 log likelihood."""

    separates: list[str]
    separation_sigma: float
    separation: float
    deciding_poses: int
    plan: dict[str, Any]


class Confirmation(Model):
    """RMS error before and after, on poses of the follow-up that were not used to decide."""

    run_id: str
    before_rms_deg: float
    after_rms_deg: float


class EffectInForce(Model):
    """An effect accepted from other runs of the unit, and the runs that its parameters were fitted to."""

    name: str
    parameters: dict[str, float | None]
    runs: list[str]


class Diagnosis(Model):
    """CONTRACT section 5, with `grade` and, in `says`, its interpretation for people, the answer first."""

    runs: list[str]
    reference: Literal["stage", "good"] = "stage"  # in diagnoses stored before it could be asked for
    known_periods_deg: list[float] = Field(default=[])
    n_poses: int
    held_out: HeldOut
    noise: ReadingNoise
    base: BaseErrors
    verdict: Literal["named", "ambiguous", "unnamed", "nothing"]
    effects: list[EffectFound]
    final: FinalErrors
    follow_up: FollowUp | None
    confirmed_by: Confirmation | None
    warnings: list[str]
    grade: Literal["good", "fair", "unknown"] = "unknown"  # in diagnoses stored before it was computed
    says: list[str] = Field(default=[])
    in_force: list[EffectInForce] = Field(default=[])  # taken out of the poses before the search
