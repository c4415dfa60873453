"""The result of a run: the fitted line, its errors of indication, the gyro, and what it rests on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

from pydantic import Field

from calrig.model.base import Model

StatedKind = Literal["setting", "harmonic", "common"]
MOST_REFERENCE_STD_DEG = 180.0
"""Above this, a stated standard uncertainty of an angle states nothing, and squares of it may overflow."""
ReferenceKind = Literal[StatedKind, "map"]
Distribution = Literal["rectangular", "normal"]
Covariance = tuple[tuple[float, float], tuple[float, float]]
StoppedBy = Literal["plan", "until"]

DoubtKind = Literal[
    "move_mismatch",  # the unit measured another rotation than the stage reported
    "missing_poses",  # poses of the plan were not measured
    "far_poses",  # single poses are far from what the others say
    "ambiguous_readings",  # some stand for two elevations, or the reading does not follow the stage
    "odd_scale",  # a reading that is not in degrees, or counts against the stage
    "clamping",  # gravity finds the unit at another clamping angle than the plan's
    "changed",  # bias or scale moved by more than repeatability and remounting explain
    "residual",  # the residual is far larger than that of the calibration in force
    "unmeasured_position",  # they moved, and the stage has no homing
    "solution_in_force",  # a less accurate run would replace a joint solution
    "effects_lost",  # a less accurate run would replace corrections
]


@dataclass(frozen=True)
class Doubt:
    """One reason why a calibration stays a draft until a person releases it.

    Attributes:
        kind: for programs.
        says: the sentence for people.
    """

    kind: DoubtKind
    says: str


class Extremes(Model):
    """Least and greatest."""

    min: float | None
    max: float | None


class Gyro(Model):
    """The gyro: bias of each axis, and the stage's rotation over the integrated rate about the stage axis."""

    bias_dps: list[float | None] = Field(min_length=3, max_length=3)
    bias_std_dps: list[float | None] = Field(min_length=3, max_length=3)
    scale: float | None
    scale_std: float | None


@dataclass(frozen=True)
class Reference:
    """What the stage's own angle is worth: a standard uncertainty, shared among poses as `kind` says.

    `distribution` is that of the error at one angle: a limit from a data sheet, ±a, is rectangular with
    std_deg = a/√3; a certificate's U/k is normal.

    Of kind `map` it is what a stage's map was worth to certain poses (`stage_map.map_reference`):
    std_deg of a calibrated elevation, and `line_covariance` of the line's offset (deg) and slope that its
    error is taken for.
    """

    std_deg: float
    kind: ReferenceKind = "harmonic"
    distribution: Distribution = "rectangular"
    line_covariance: Covariance | None = None

    @property
    def combined_distribution(self) -> Distribution:
        """The distribution of its part in a result: normal for `setting`, a mean over the poses."""
        return "normal" if self.kind == "setting" else self.distribution


class ReferenceFigures(Model):
    """What the rig states of its stage, and its part of bias and scale: type B, √n does not shrink it."""

    std_deg: float
    kind: ReferenceKind
    bias_std_deg: float
    scale_std: float | None
    distribution: Distribution = "rectangular"
    line_covariance: Covariance | None = Field(
        default=None, description="Of the line that a map's error is taken for; null but for `map`."
    )

    @property
    def reference(self) -> Reference:
        """What the rig states."""
        return Reference(self.std_deg, self.kind, self.distribution, self.line_covariance)


@dataclass(frozen=True)
class RangeErrors:
    """The line that was found and, over the range, the error that is left once everything is applied.

    Attributes:
        bias_deg, scale: as found, beside all effects accepted.
        covariance: of bias and scale, type A; None where too few poses tell.
        freedom: degrees of freedom of the scatter that it is from.
        expanded_uncertainty_deg: of one calibrated elevation; None where the reference is not known.
        error_expanded_uncertainty_deg: of the errors below: it contains the noise of a reading, where that of
            an elevation contains the whole residual. None where the reference is not known.
        coverage_factor: its k, for the probability `coverage`.
        elevation_deg: (m,) in the middle of stretches of the range, ascending.
        lowest_error_deg: (m,) of the poses in each stretch, calibrated elevation less θ.
        highest_error_deg: (m,) of the same poses.
        mean_error_deg: over the range; what a fit leaves has about none, what is verified may.
        error_steps: independent errors, each of bias, of scale and of an elevation at each place; None where
            bias and scale have no others beside them.
    """

    bias_deg: float
    scale: float | None
    covariance: Covariance | None
    freedom: int
    expanded_uncertainty_deg: float | None
    error_expanded_uncertainty_deg: float | None
    coverage_factor: float | None
    coverage: float
    elevation_deg: tuple[float, ...]
    lowest_error_deg: tuple[float, ...]
    highest_error_deg: tuple[float, ...]
    mean_error_deg: float
    error_steps: tuple[tuple[float, ...], ...] | None = None


class Verified(Model):
    """How a verification's poses were tested, and which of them lie within the calibrated range."""

    n_tested: int = Field(description="Poses within the calibrated range.")
    n_outside: int
    calibrated_deg: Extremes
    measured_deg: Extremes
    calibrated_c: Extremes | None
    measured_c: Extremes | None
    rms_deg: float | None = Field(None, description="RMS error of the tested poses; null if none was tested.")
    ratio: float | None = Field(None, description="Residual over what noise and stated uncertainty predict.")
    bound: float | None = Field(None, description="What the ratio stays under in 99 % of runs.")
    p_value: float | None = None
    correlation: float | None = Field(None, description="Of the noise from pose to pose, lag 1.")
    against_calibration_p: float | None = Field(
        None, description="Of the same errors against the scatter of the calibration's own poses."
    )


class FittedLine(Model):
    """The figures of a fitted line: of a run's result, and of it among others."""

    bias_deg: float
    bias_std_deg: float | None
    scale: float | None
    scale_std: float | None
    rms_raw_deg: float
    rms_calibrated_deg: float | None
    rms_with_effects_deg: float | None


class Result(FittedLine):
    """reading = bias_deg + scale·elevation; RMS as √(Σr²/n). `bias_std_deg`, `scale_std` are of type A."""

    n_poses: int
    noise_deg: float | None
    temperature_c: Extremes | None
    gyro: Gyro
    reference: ReferenceFigures | None = None  # of runs stored before it was computed: null
    over_range: RangeErrors | None = None  # null in runs stored before it was computed
    stopped_by: StoppedBy = "plan"
    doubts: list[Doubt] = Field(default=[])  # unset: not kept, since the run made no draft or is an old one
    reference_says: str | None = Field(
        None, description="Why the stage's map was not used, or what errors are relative to."
    )
    lost_says: str | None = Field(None, description="What of the plan could not be measured.")
    far_says: str | None = Field(None, description="Which poses are far from what the others say.")
    verified: Verified | None = Field(None, description="Of a verification; null in earlier versions.")

    def to_dict(self) -> dict[str, Any]:
        """Return the result as it is stored: without what only some results have to say."""
        document = self.model_dump(mode="json")
        for key in ("reference_says", "lost_says", "far_says", "verified"):
            if document[key] is None:
                del document[key]
        if "doubts" not in self.model_fields_set:
            del document["doubts"]
        if self.reference is not None and self.reference.line_covariance is None:
            del document["reference"]["line_covariance"]
        return document

    def with_doubts(self, doubts: Sequence[Doubt]) -> Self:
        """Return the result with the doubts about it, none among them."""
        return self.model_copy(update={"doubts": list(doubts)})
