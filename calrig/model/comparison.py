"""Units side by side: their calibrations, how each drifts, and whether it changed."""

from datetime import datetime
from typing import Literal

from pydantic import Field

from calrig.model.base import Model
from calrig.model.diagnosis import EffectFound
from calrig.model.result import Extremes, FittedLine, Gyro
from calrig.model.run import Suspect
from calrig.model.verdict import Answer, Left

ChangeVerdict = Literal["changed", "unchanged", "not_known"]


class GyroDifference(Gyro):
    """A run's gyro figures less those of the run before; `…_std` are of the noise of both runs alone.

    They are no part of the test for changes: the bias of a gyro drifts with time and temperature.
    """

    bias_dps: list[float | None] = Field(min_length=3, max_length=3, description="Of x, y and z.")


class Difference(Model):
    """A run less the one before it, by plain fits; `…_sigma` are differences over standard uncertainties.

    The uncertainty contains the standard errors of both runs, the remounting and between-day components
    (pooled over all units) and, from rig to rig, the uncertainty of the stages. `p_value` and the other
    figures are null where they cannot be computed yet.
    """

    from_: str = Field(alias="from")
    to: str
    days: float
    bias_deg: float | None
    bias_std_deg: float | None
    bias_sigma: float | None
    scale: float | None
    scale_std: float | None
    scale_sigma: float | None
    rms_deg: float | None = Field(description="Of the RMS error after the plain fit of bias and scale.")
    p_value: float | None
    verdict: ChangeVerdict
    effects: list[EffectFound] | None = Field(
        description="Effects that changed, by the diagnosis of both runs together: null without one."
    )
    says: str


class Change(Difference):
    """A difference with the gyro's, and whether the unit's control chart signals at the later run.

    `signal` is null without a chart, `gyro` where one of the runs has no gyro figures.
    """

    gyro: GyroDifference | None
    signal: bool | None


class ComparedRun(FittedLine):
    """The figures of one completed, not voided calibration."""

    run_id: str
    finished_at: datetime
    temperature_c: Extremes
    effects: list[str]
    suspect: Suspect | None


class InForce(Model):
    """Bias and scale of the revision in force, fitted with its effects."""

    revision: int
    run_id: str
    bias_deg: float | None = Field(description="Null in a joint solution, which does not know the level.")
    bias_std_deg: float | None
    scale: float | None
    scale_std: float | None
    rms_deg: float | None = Field(description="Of the residual after its effects.")
    effects: list[str]
    answer: Answer | Literal["no_limits"] = Field(description="Of its verdict, as issued.")
    left: Left | None = Field(description="Of its verdict, as issued.")


class ComparedUnit(Model):
    """A unit's calibrations by their plain fits, the oldest first, what is in force, and whether it changed.

    `p_value` is that of the unit over all its runs, `change` its most significant difference, `verdict`
    whether it changed: `not_known` of a unit with one run.
    """

    unit: str
    runs: list[ComparedRun]
    in_force: InForce | None
    drift_deg_per_day: float | None
    p_value: float | None
    changed: bool
    verdict: ChangeVerdict
    change: Difference | None
    due_at: datetime | None
    overdue: bool
    due_method: Literal["interval", "drift"] | None
    due_says: str


class Spread(Model):
    """Standard deviation between units, and of the runs of one unit about their mean (repeatability)."""

    between_units_std: float | None
    within_unit_std: float | None
    says: str


class Spreads(Model):
    """The spread of bias and scale."""

    bias_deg: Spread
    scale: Spread


class Reproducibility(Model):
    """Remounting, between-day and between-rig components of a figure, over all units.

    `day_std` is null where it cannot be separated from `reclamping_std`, which then contains both; `freedom`
    is the number of degrees of freedom.
    """

    reclamping_std: float
    day_std: float | None
    rig_std: float
    freedom: int


class Reproducibilities(Model):
    """Reproducibility of bias and scale (null where the runs do not suffice), and the rule for changes."""

    bias_deg: Reproducibility | None
    scale: Reproducibility | None
    false_discovery_rate: float
    rule: str
    says: str


class Comparison(Model):
    """Units side by side, those first that changed."""

    units: list[ComparedUnit]
    spread: Spreads
    repeatability: Reproducibilities
