"""A unit's issued calibration (CONTRACT section 6), and its state among the unit's revisions."""

from datetime import datetime
from typing import Any, Literal

from pydantic import ConfigDict, Field

from calrig.model.base import Model
from calrig.model.result import Extremes
from calrig.model.verdict import Verdict

RevisionStatus = Literal["draft", "in_force", "superseded", "withdrawn"]


class NamedEffect(Model):
    """An accepted effect of the unit itself."""

    name: str
    parameters: dict[str, float | None]
    formula: str


class CalibrationGyro(Model):
    """The gyro's part of a calibration."""

    bias_dps: list[float | None] = Field(min_length=3, max_length=3)
    scale: float | None


class Uncertainty(Model):
    """Standard uncertainties of a calibrated elevation; the expanded uncertainty contains all of them."""

    type_a_deg: float | None
    type_b_deg: float | None
    reference_deg: float | None
    reference_bias_deg: float | None
    reference_scale: float | None


class Accelerometer(Model):
    """true = matrix·(raw − bias)."""

    bias_g: list[float]
    matrix: list[list[float]]


class JointCovariance(Model):
    """Covariance of bias, scale and the parameters of effects, such as `effects[0].amplitude_deg`.

    A calibrated elevation has the variance (scatter² + g·matrix·gᵀ)/(slope of the reading)², with g the
    derivatives of the reading by the parameters, and that of the reference.
    """

    parameters: list[str]
    matrix: list[list[float]]
    scatter_deg: float = Field(description="Standard deviation of a reading about the calibration.")
    slope: float = Field(
        description="Of the reading by elevation; its inverse square is the mean of those of the poses."
    )


class Calibration(Model):
    """A unit's calibration (CONTRACT section 6); it never changes once issued.

    It is served and hashed as the bytes that were issued, never as a dump of this model.
    """

    model_config = ConfigDict(json_schema_serialization_defaults_required=False)

    schema_: Literal["calrig.calibration/2"] = Field(alias="schema")
    unit: str
    revision: int
    issued_at: datetime
    sha256: str
    run_id: str
    calibrated_at: datetime | None
    rig: str | None
    range_deg: list[float] = Field(min_length=2, max_length=2)
    model: str
    bias_deg: float
    scale: float
    covariance: list[list[float]] | None
    joint_covariance: JointCovariance | None = Field(
        default=None, description="Null without effects of known standard errors, and in older documents."
    )
    effects: list[NamedEffect]
    gyro: CalibrationGyro | None
    rms_raw_deg: float
    rms_calibrated_deg: float | None
    rms_with_effects_deg: float | None
    expanded_uncertainty_deg: float | None
    coverage_factor: float | None
    coverage: float
    level_known: bool
    level_std_deg: float | None
    accelerometer: Accelerometer | None
    uncertainty: Uncertainty
    temperature_c: Extremes | None
    provenance: dict[str, Any]
    degrees_of_freedom: float | None = Field(
        default=None, description="Of the standard errors of bias and scale; null in older documents."
    )
    readings_wrap: bool | None = Field(
        default=None,
        description="Whether readings start anew after 360°, as the poses show; null where they do not, and "
        "in older documents.",
    )
    warnings: list[str] = Field(
        default=[],
        description="Why the verdict was not reliable when made; absent in older documents.",
    )


class RevisionChange(Model):
    """A revision less the revision in force."""

    revision: int = Field(description="The one in force.")
    bias_deg: float
    scale: float | None
    expanded_uncertainty_deg: float | None


class RevisionAct(Model):
    """A release or the withdrawal of a revision."""

    at: datetime
    what: Literal["released", "withdrawn"]
    by: str | None
    reason: str | None
    supersedes: int | None = Field(
        description="Revision that was in force until this release; null if none was."
    )


class Revision(Model):
    """An issued revision: figures, run, who made it and why, and what has changed since of its basis."""

    revision: int
    status: RevisionStatus
    run_id: str
    effects: list[str]
    issued_at: datetime
    issued_by: str | None
    reason: str | None
    sha256: str
    verdict: Verdict
    warnings: list[str] = Field(
        description="Why it was not released automatically; a release needs a reason."
    )
    stale: list[str]
    bias_deg: float
    bias_std_deg: float | None
    scale: float | None
    scale_std: float | None
    expanded_uncertainty_deg: float | None
    change: RevisionChange | None = Field(description="Null of the revision in force, and if none is.")
    acts: list[RevisionAct] = Field(description="Its releases and its withdrawal, oldest first.")


class IssuedAct(Model):
    """One act on a revision of a unit's calibration."""

    at: datetime
    what: Literal["drafted", "released", "withdrawn"]
    unit: str
    revision: int
    run_id: str
    sha256: str
    by: str | None
    reason: str | None
    warnings: list[str] = Field(description="Those of the revision.")
    supersedes: int | None = Field(
        description="Of a release, the revision that was in force until then; null if none was."
    )
